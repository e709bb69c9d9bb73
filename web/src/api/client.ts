/** One door to the server: JSON in, JSON out, and errors as the problem the server described. */
import { decode } from '../sky/decode';
import type * as T from './types';

export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly problem: T.Problem,
  ) {
    super(problem.message);
  }
}

/** What the session lends to every request, and whom a 401 is told (state/session.svelte.ts fills it in). */
export const door = {
  mark: '1',
  refused: (): Promise<void> => Promise.resolve(),
  back: (): Promise<void> => Promise.resolve(),
};
const OPEN = ['/session', '/session/password', '/setup', '/password-links', '/password-links/check'];

function problemOf(status: number, body: unknown): T.Problem {
  const given = (body ?? {}) as Partial<T.Problem> & { detail?: unknown };
  const fallback = typeof given.detail === 'string' ? given.detail : `the server answered ${status}`;
  return {
    id: given.id ?? '',
    message: given.message ?? fallback,
    expected: given.expected ?? '',
    got: given.got ?? '',
    hint: given.hint ?? '',
  };
}

function gone(signal: AbortSignal | null | undefined): Promise<never> {
  return new Promise((_, reject) => signal?.addEventListener('abort', () => reject(new DOMException('no longer wanted', 'AbortError')), { once: true }));
}

/** The answer, or the problem the server described; a read that found nobody signed in waits until somebody is. */
async function fetched(path: string, init?: RequestInit): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(`/api${path}`, init);
  } catch (error) {
    if (error instanceof DOMException && error.name === 'AbortError') throw error;
    const hint = init?.method === undefined ? 'The page reads it again when the server is back.' : 'The request is not repeated. Check whether it took effect before you repeat it.';
    throw new ApiError(0, { id: '', message: 'no answer from the server', expected: '', got: '', hint });
  }
  if (response.ok) return response;
  if (response.status === 401 && !OPEN.includes(path)) {
    await door.refused();
    if (init?.method === undefined) {
      await Promise.race([door.back(), gone(init?.signal)]);
      return fetched(path, init);
    }
  }
  throw new ApiError(response.status, problemOf(response.status, await response.json().catch(() => null)));
}

async function answer<R>(path: string, init?: RequestInit): Promise<R> {
  const response = await fetched(path, init);
  return (response.status === 204 ? null : await response.json()) as R;
}

/** False only if no connection to the server could be made. */
async function probe(signal: AbortSignal): Promise<boolean> {
  try {
    await fetch('/api/health', { signal, cache: 'no-store' });
    return true;
  } catch {
    return signal.aborted;
  }
}

export const get = <R>(path: string, signal?: AbortSignal): Promise<R> => answer<R>(path, signal ? { signal } : undefined);
/** What browsers keep of a page that is gone, with room to spare. */
const KEPT = 32_768;
/** How a change is sent. It leaves even when its page is left or closed in the same moment: whoever pressed ABORT has sent it. */
function change(method: string, body?: unknown): RequestInit {
  const text = body === undefined ? null : JSON.stringify(body);
  return { method, headers: { 'X-GSS': door.mark, 'Content-Type': 'application/json' }, body: text, keepalive: (text?.length ?? 0) < KEPT };
}
export const post = <R>(path: string, body?: unknown, signal?: AbortSignal): Promise<R> => answer<R>(path, { ...change('POST', body), ...(signal && { signal, keepalive: false }) });

export const send = <R>(method: 'PUT' | 'DELETE', path: string, body?: unknown): Promise<R> =>
  answer<R>(path, change(method, body));

export interface RawImage {
  columns: number;
  rows: number;
  bits: number;
  /** What is painted: the values themselves, or 16-bit steps of a floating-point image. */
  pixels: Uint8Array | Uint16Array;
  /** DN of a painted step: `offset + scale · step`. */
  offset: number;
  scale: number;
}

async function raw(id: number, signal?: AbortSignal): Promise<RawImage> {
  const response = await fetched(`/frames/${id}/raw`, signal ? { signal } : undefined);
  const columns = Number(response.headers.get('X-Columns'));
  const rows = Number(response.headers.get('X-Rows'));
  const bits = Number(response.headers.get('X-Bits'));
  const buffer = await response.arrayBuffer();
  const [dtype, count] = [response.headers.get('X-Dtype') ?? '', columns * rows];
  const aside = buffer.byteLength >= count * 4 ? (await import('../sky/painter')).decodeAside : decode;
  return { columns, rows, bits, ...(await aside(buffer, dtype, count)) };
}

export function query(values: Record<string, string | number | undefined>): string {
  const used = Object.entries(values).filter(([, v]) => v !== undefined && v !== '');
  return used.length ? `?${new URLSearchParams(used.map(([k, v]) => [k, String(v)] as [string, string])).toString()}` : '';
}

export const api = {
  session: () => get<T.SessionInfo>('/session'),
  signIn: (name: string, password: string) => post<T.SessionInfo>('/session', { name, password }),
  signOut: () => send<null>('DELETE', '/session'),
  changePassword: (old: string, fresh: string) => send<T.SessionInfo>('PUT', '/session/password', { old, new: fresh }),
  setUp: (token: string, name: string, password: string) => post<T.SessionInfo>('/setup', { token, name, password }),
  welcome: (token: string, password: string) => post<T.SessionInfo>('/password-links', { token, password }),
  checkLink: (kind: 'setup' | 'password', token: string) => post<null>('/password-links/check', { kind, token }),
  link: () => get<T.Link>('/link'),
  openLink: (url: string) => post<T.Link>('/link/open', { url }),
  closeLink: () => post<T.Link>('/link/close'),
  acknowledgeDictionary: () => post<T.Link>('/link/acknowledge-dictionary'),
  dictionary: () => get<T.Dictionary>('/dictionary'),
  findCommands: (filter: Record<string, string | number | undefined>, signal?: AbortSignal) => get<T.Command[]>(`/commands${query({ limit: 200, ...filter })}`, signal),
  commands: (limit = 100, contact?: number) => get<T.Command[]>(`/commands${query({ limit, contact })}`),
  send: (name: string, args: Record<string, T.ArgumentValue>, confirm = '') => post<T.Command>('/commands', { name, arguments: args, confirm }),
  check: (name: string, args: Record<string, T.ArgumentValue>, signal?: AbortSignal) => post<T.Check>('/commands/check', { name, arguments: args }, signal),
  retry: (id: number) => post<T.Command>(`/commands/${id}/retry`),
  resolve: (id: number, note: string) => post<T.Command>(`/commands/${id}/resolve`, { note }),
  /** Keeps `keepalive` beside the signal: a press of ABORT leaves even when its page is closed in the same moment. */
  abort: (signal: AbortSignal) => answer<T.Abort>('/commands/abort', { ...change('POST'), signal }),
  probe,
  latest: () => get<T.Latest>('/telemetry/latest'),
  cycles: (limit = 12) => get<T.Cycle[]>(`/telemetry/cycles?limit=${limit}`),
  history: (names: string[], start: string, end: string, points = 600) => {
    const q = new URLSearchParams(names.map((n) => ['name', n]));
    q.set('start', start);
    q.set('end', end);
    q.set('points', String(points));
    return get<T.History>(`/telemetry/history?${q.toString()}`);
  },
  frames: (filters: Record<string, string | number | undefined>) => get<T.FramePage>(`/frames${query(filters)}`),
  frame: (id: number, signal?: AbortSignal) => get<T.FrameDetail>(`/frames/${id}`, signal),
  frameReplay: (id: number, signal?: AbortSignal) => get<T.FrameReplay>(`/frames/${id}/replay`, signal),
  raw,
  histogram: (id: number, signal?: AbortSignal) => get<T.Histogram>(`/frames/${id}/histogram`, signal),
  solve: (id: number, body: T.SolveIn) => post<T.SolutionDetail>(`/frames/${id}/solve`, body),
  pin: (id: number, solutionId: number) => send<T.FrameDetail>('PUT', `/frames/${id}/operational`, { solution_id: solutionId }),
  solution: (id: number, signal?: AbortSignal) => get<T.SolutionDetail>(`/solutions/${id}`, signal),
  importFrame: (file: File, profile: string) => {
    const form = new FormData();
    form.append('file', file);
    if (profile) form.append('profile', profile);
    return answer<T.FrameDetail>('/frames/import', { method: 'POST', headers: { 'X-GSS': door.mark }, body: form });
  },
  catalogues: () => get<T.Catalogue[]>('/catalogues'),
  catalogue: (id: number) => get<T.CatalogueDetail>(`/catalogues/${id}`),
  build: (body: T.CatalogueIn) => post<T.Job>('/catalogues', body),
  preview: (body: T.CatalogueIn, ambiguity: boolean, signal?: AbortSignal) => post<T.Preview>(`/catalogues/preview${ambiguity ? '?ambiguity=true' : ''}`, body, signal),
  catalogueDiff: (old: number, now: number) => get<T.CatalogueDiff>(`/catalogues/diff?old=${old}&new=${now}`),
  timeline: (device?: number) => get<T.Timeline>(`/catalogues/timeline${query({ device })}`),
  starLists: () => get<T.StarList[]>('/catalogues/sources'),
  addStarList: (file: File, mapping: Record<string, string | number>) => {
    const form = new FormData();
    form.append('file', file);
    form.append('mapping', JSON.stringify(mapping));
    return answer<T.StarList>('/catalogues/sources', { method: 'POST', headers: { 'X-GSS': door.mark }, body: form });
  },
  upload: (id: number, bank: string) => post<T.Transfer>(`/catalogues/${id}/upload`, { bank }),
  transfers: (limit = 20) => get<T.Transfer[]>(`/transfers?limit=${limit}`),
  transferAction: (id: number, action: 'pause' | 'resume' | 'abort') => post<T.Transfer>(`/transfers/${id}/${action}`),
  jobs: (limit = 20) => get<T.Job[]>(`/jobs?limit=${limit}`),
  cancelJob: (id: number) => post<T.Job>(`/jobs/${id}/cancel`),
  events: (after: number, limit = 200) => get<T.EventRow[]>(`/events?after=${after}&limit=${limit}`),
  eventsOf: (start: string, end: string, limit = 500) => get<T.EventRow[]>(`/events${query({ start, end, limit })}`),
  authority: () => get<T.Authority>('/authority'),
  authorityAction: (action: 'take' | 'release' | 'break', reason = '') => post<T.Authority>(`/authority/${action}`, action === 'break' ? { reason } : undefined),
  withdraw: (id: number) => post<T.Command>(`/commands/${id}/withdraw`),
  alarms: (open: boolean, limit = 200) => get<T.AlarmRow[]>(`/alarms${query({ open: String(open), limit })}`),
  alarmAction: (id: number, action: 'acknowledge' | 'unshelve' | 'clear', note: string) => post<T.AlarmRow>(`/alarms/${id}/${action}`, { note }),
  shelve: (id: number, minutes: number, note: string) => post<T.AlarmRow>(`/alarms/${id}/shelve`, { minutes, note }),
  limits: () => get<T.Limits>('/telemetry/limits'),
  chooseLimitSet: (name: string) => send<T.Limits>('PUT', '/telemetry/limits/set', { name, note: '' }),
  stacks: () => get<T.Stack[]>('/stacks'),
  saveStack: (body: T.StackIn, id: number | null) => (id === null ? post<T.Stack>('/stacks', body) : send<T.Stack>('PUT', `/stacks/${id}`, body)),
  dropStack: (id: number) => send<null>('DELETE', `/stacks/${id}`),
  checkStack: (id: number) => post<T.StackCheck>(`/stacks/${id}/check`),
  runStack: (id: number, confirm: string[]) => post<T.StackRun>(`/stacks/${id}/run`, { confirm }),
  stackRuns: () => get<T.StackRun[]>('/stack-runs?limit=20'),
  checkSteps: (steps: T.StackIn['steps']) => post<T.StackCheck>('/stacks/check', { steps }),
  goOn: (run: number, skip: string, confirm: string[]) => post<T.StackRun>(`/stack-runs/${run}/go-on`, { skip, confirm }),
  runAction: (id: number, action: 'pause' | 'resume' | 'stop') => post<T.StackRun>(`/stack-runs/${id}/${action}`),
  schedule: () => get<T.Schedule>('/schedule'),
  refreshSchedule: () => post<T.Command>('/schedule/refresh'),
  checkScheduled: (body: unknown, signal?: AbortSignal) => post<T.ScheduleCheck>('/schedule/check', body, signal),
  addScheduled: (body: unknown) => post<T.Command>('/schedule', body),
  cancelScheduled: (id: number) => post<T.Command>(`/schedule/${id}/cancel`),
  tables: (kind: string) => get<T.Table[]>(`/tables${query({ kind, limit: 100 })}`),
  tablesOnBoard: () => get<T.OnBoardTable[]>('/tables/on-board'),
  tableDefaults: (kind: string, profile: string) => get<{ content: Record<string, string | number> }>(`/tables/defaults${query({ kind, profile })}`),
  addTable: (body: unknown) => post<T.TableDetail>('/tables', body),
  uploadTable: (id: number, bank: string) => post<T.Transfer>(`/tables/${id}/upload`, { bank }),
  startDownload: (body: unknown) => post<T.Transfer>('/transfers/download', body),
  uploadFrame: (id: number, slot: number, solve: boolean) => post<T.Transfer>(`/frames/${id}/upload`, { slot, solve }),
  experiments: () => get<T.ExperimentEntry[]>('/campaigns/experiments'),
  runExperiments: (body: { names: string[]; trials: number | null; seed: number }) => post<T.Job>('/campaigns/experiments', body),
  reprocess: (body: { chain: string; again: boolean }) => post<T.Job>('/campaigns/reprocess', body),
  compareChains: () => get<T.ChainRecord[]>('/campaigns/chains'),
  calibrations: () => get<T.CalibrationRow[]>('/calibrations'),
  calibration: (id: number) => get<T.CalibrationDetail>(`/calibrations/${id}`),
  calibrate: (body: unknown) => post<T.Job>('/calibrations', body),
  compareCalibrations: (older: number, newer: number) => get<T.CalibrationDiff>(`/calibrations/diff${query({ older, newer })}`),
  useCalibration: (id: number) => post<T.CalibrationDetail>(`/calibrations/${id}/use`),
  useDocumented: (profile: string) => post<null>('/calibrations/documented', { profile }),
  calibrationTable: (id: number) => post<T.TableDetail>(`/calibrations/${id}/table`),
  analyses: () => get<T.AnalysisRow[]>('/analyses'),
  analysis: (id: number) => get<T.AnalysisDetail>(`/analyses/${id}`),
  analyse: (body: unknown) => post<T.Job>('/analyses', body),
  contact: (id: number) => get<T.ContactDetail>(`/contacts/${id}`),
  noteContact: (id: number, note: string) => send<T.ContactDetail>('PUT', `/contacts/${id}/note`, { note }),
  replay: () => get<T.Replay>('/replay'),
  startReplay: (id: number, speed: number | null) => post<T.Replay>(`/contacts/${id}/replay`, { speed }),
  steerReplay: (body: { speed?: number | null; paused?: boolean; at?: string }) => send<T.Replay>('PUT', '/replay', body),
  endReplay: () => send<T.Replay>('DELETE', '/replay'),
  contacts: () => get<T.Contact[]>('/contacts'),
  contactPage: async (limit: number, offset: number): Promise<{ total: number; contacts: T.Contact[] }> => {
    const response = await fetched(`/contacts${query({ limit, offset })}`);
    const contacts = (await response.json()) as T.Contact[];
    return { total: Number(response.headers.get('X-Total') ?? contacts.length), contacts };
  },
  sky: (mag = 4.5, at?: string) => get<T.Sky>(`/sky${query({ mag, at })}`),
  figures: () => get<T.Figure[]>('/sky/figures'),
  profiles: () => get<T.Profile[]>('/profiles'),
  designCameras: () => get<T.DesignCameras>('/design/cameras'),
  design: (body: T.DesignIn, signal?: AbortSignal) => post<T.Design>('/design', body, signal),
  runDesign: (body: T.DesignIn) => post<T.Job>('/design/run', body),
};

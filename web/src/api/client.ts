/**
 * The console's requests to the HTTP API. Paths, parameters, bodies and responses are type-checked against the server's
 * OpenAPI document.
 */
import { base } from '../lib/base';
import type { paths } from './generated/schema';
import { body, fetched, given, http, multipart, OutlivingRequest } from './http';
import type * as T from './types';
import { handover } from './handover';
import { views } from './views';

export { ApiError, sessionHooks, queryString } from './http';

const { GET, POST, PUT, DELETE } = http;
/** Query parameters of a GET operation. */
export type Query<P extends keyof paths> = paths[P] extends { get: { parameters: { query?: infer Q } } }
  ? Partial<NonNullable<Q>>
  : never;
/** Body of a POST operation. */
export type Body<P extends keyof paths> = paths[P] extends {
  post: { requestBody: { content: { 'application/json': infer B } } };
}
  ? B
  : never;
type TableKind = Body<'/api/tables'>['kind'];
type Arguments = Record<string, T.ArgumentValue>;

/** Request the server's health. Returns false only if no connection to the server could be opened. */
async function probe(signal: AbortSignal): Promise<boolean> {
  try {
    await fetch(`${base}/api/health`, { signal, cache: 'no-store' });
    return true;
  } catch {
    return signal.aborted;
  }
}

const session = {
  session: () => body(GET('/api/session')),
  signIn: (name: string, password: string) => body(POST('/api/session', { body: { name, password } })),
  signOut: () => body(DELETE('/api/session')),
  changePassword: (old: string, fresh: string) => body(PUT('/api/session/password', { body: { old, new: fresh } })),
  chooseStartPage: (path: string) => body(PUT('/api/session/start-page', { body: { path } })),
  setUp: (token: string, name: string, password: string) =>
    body(POST('/api/setup', { body: { token, name, password } })),
  welcome: (token: string, password: string) => body(POST('/api/password-links', { body: { token, password } })),
  checkLink: (kind: 'setup' | 'password', token: string) =>
    body(POST('/api/password-links/check', { body: { kind, token } })),
  authority: () => body(GET('/api/authority')),
  authorityAction: (action: 'take' | 'release' | 'request' | 'accept' | 'decline' | 'break', note = '') =>
    action === 'break'
      ? body(POST('/api/authority/break', { body: { reason: note } }))
      : action === 'take' || action === 'release'
        ? body(POST(`/api/authority/${action}`))
        : body(POST(`/api/authority/${action}`, { body: { note } })),
  offerAuthority: (user: string, note: string) => body(POST('/api/authority/offer', { body: { user, note } })),
};

/** Requests for all units of the server, and ABORT of any unit. */
const fleet = {
  fleet: (signal?: AbortSignal) => body(GET('/api/fleet', { signal })),
  abortUnit: async (name: string): Promise<T.Abort> => {
    const url = `${location.origin}/units/${encodeURIComponent(name)}/api/commands/abort`;
    return (await (await fetched(new OutlivingRequest(url, { method: 'POST' }))).json()) as T.Abort;
  },
  restartUnit: (name: string) => body(POST('/api/fleet/units/{name}/restart', { params: { path: { name } } })),
  heads: (signal?: AbortSignal) => body(GET('/api/fleet/spacecraft', { signal })),
  saveSpacecraft: (spacecraft: T.SpacecraftRequest, spacecraft_id: number | null) =>
    spacecraft_id === null
      ? body(POST('/api/fleet/spacecraft', { body: spacecraft }))
      : body(PUT('/api/fleet/spacecraft/{spacecraft_id}', { params: { path: { spacecraft_id } }, body: spacecraft })),
  dropSpacecraft: (spacecraft_id: number) =>
    body(DELETE('/api/fleet/spacecraft/{spacecraft_id}', { params: { path: { spacecraft_id } } })),
  correctHead: (spacecraft_id: number, unit: string) =>
    body(
      POST('/api/fleet/spacecraft/{spacecraft_id}/correct', { params: { path: { spacecraft_id } }, body: { unit } }),
    ),
  headHistory: (spacecraft_id: number, hours: number) =>
    body(
      GET('/api/fleet/spacecraft/{spacecraft_id}/history', { params: { path: { spacecraft_id }, query: { hours } } }),
    ),
};

const line = {
  link: () => body(GET('/api/link')),
  openLink: (url: string) => body(POST('/api/link/open', { body: { url } })),
  closeLink: () => body(POST('/api/link/close')),
  acknowledgeDictionary: () => body(POST('/api/link/acknowledge-dictionary')),
  dictionary: () => body(GET('/api/dictionary')),
  probe,
  contact: (contact_id: number) => body(GET('/api/contacts/{contact_id}', { params: { path: { contact_id } } })),
  contactRecord: (contact_id: number) =>
    body(GET('/api/contacts/{contact_id}/record', { params: { path: { contact_id } } })),
  noteContact: (contact_id: number, note: string) =>
    body(PUT('/api/contacts/{contact_id}/note', { params: { path: { contact_id } }, body: { note } })),
  contacts: () => body(GET('/api/contacts')),
  contactPage: async (limit: number, offset: number): Promise<{ total: number; contacts: T.Contact[] }> => {
    const { data = [], response } = await GET('/api/contacts', { params: { query: { limit, offset } } });
    return { total: Number(response.headers.get('X-Total') ?? data.length), contacts: data };
  },
  replay: () => body(GET('/api/replay')),
  startReplay: (contact_id: number, speed: number | null) =>
    body(POST('/api/contacts/{contact_id}/replay', { params: { path: { contact_id } }, body: { speed } })),
  steerReplay: (change: { speed?: number | null; paused?: boolean; at?: string }) =>
    body(PUT('/api/replay', { body: change })),
  endReplay: () => body(DELETE('/api/replay')),
  events: (after: number, limit = 200) => body(GET('/api/events', { params: { query: { after, limit } } })),
  eventsOf: (start: string, end: string, limit = 500) =>
    body(GET('/api/events', { params: { query: { start, end, limit } } })),
};

const commanding = {
  findCommands: (filter: Query<'/api/commands'>, signal?: AbortSignal) =>
    body(GET('/api/commands', { params: { query: given({ limit: 200, ...filter }) }, signal })),
  commands: (limit = 100, contact?: number) =>
    body(GET('/api/commands', { params: { query: given({ limit, contact }) } })),
  send: (name: string, args: Arguments, confirm = '') =>
    body(POST('/api/commands', { body: { name, arguments: args, confirm } })),
  check: (name: string, args: Arguments, signal?: AbortSignal) =>
    body(POST('/api/commands/check', { body: { name, arguments: args }, signal, keepalive: false })),
  retry: (command_id: number) => body(POST('/api/commands/{command_id}/retry', { params: { path: { command_id } } })),
  resolve: (command_id: number, note: string) =>
    body(POST('/api/commands/{command_id}/resolve', { params: { path: { command_id } }, body: { note } })),
  withdraw: (command_id: number) =>
    body(POST('/api/commands/{command_id}/withdraw', { params: { path: { command_id } } })),
  /**
   * Send ABORT. The request is sent even if the page is closed immediately. The server rejects it with status 412 if it
   * has started again since `serverStarted`.
   */
  abort: (signal: AbortSignal, serverStarted: string | null) =>
    body(POST('/api/commands/abort', { signal, params: { header: { 'server-started': serverStarted } } })),
  procedures: () => body(GET('/api/procedures')),
  schedule: () => body(GET('/api/schedule')),
  refreshSchedule: () => body(POST('/api/schedule/refresh')),
  checkScheduled: (entry: Body<'/api/schedule/check'>, signal?: AbortSignal) =>
    body(POST('/api/schedule/check', { body: entry, signal, keepalive: false })),
  addScheduled: (entry: Body<'/api/schedule'>) => body(POST('/api/schedule', { body: entry })),
  cancelScheduled: (schedule_id: number) =>
    body(POST('/api/schedule/{schedule_id}/cancel', { params: { path: { schedule_id } } })),
};

const telemetry = {
  latest: () => body(GET('/api/telemetry/latest')),
  cycles: (limit = 12) => body(GET('/api/telemetry/cycles', { params: { query: { limit } } })),
  history: (name: string[], start: string, end: string, points = 600) =>
    body(GET('/api/telemetry/history', { params: { query: { name, start, end, points } } })),
  alarms: (open: boolean, limit = 200) => body(GET('/api/alarms', { params: { query: { open, limit } } })),
  alarmAction: (alarm_id: number, action: 'acknowledge' | 'unshelve' | 'clear', note: string) =>
    body(POST(`/api/alarms/{alarm_id}/${action}`, { params: { path: { alarm_id } }, body: { note } })),
  shelve: (alarm_id: number, minutes: number, note: string) =>
    body(POST('/api/alarms/{alarm_id}/shelve', { params: { path: { alarm_id } }, body: { minutes, note } })),
  limits: () => body(GET('/api/telemetry/limits')),
  chooseLimitSet: (name: string) => body(PUT('/api/telemetry/limits/set', { body: { name, note: '' } })),
};

const frames = {
  frames: (filter: Query<'/api/frames'>) => body(GET('/api/frames', { params: { query: given(filter) } })),
  differences: (limit: number) => body(GET('/api/frames/differences', { params: { query: { limit } } })),
  frame: (frame_id: number, signal?: AbortSignal) =>
    body(GET('/api/frames/{frame_id}', { params: { path: { frame_id } }, signal })),
  frameReplay: (frame_id: number, signal?: AbortSignal) =>
    body(GET('/api/frames/{frame_id}/replay', { params: { path: { frame_id } }, signal })),
  histogram: (frame_id: number, signal?: AbortSignal) =>
    body(GET('/api/frames/{frame_id}/histogram', { params: { path: { frame_id } }, signal })),
  solve: (frame_id: number, request: T.SolveIn) =>
    body(POST('/api/frames/{frame_id}/solve', { params: { path: { frame_id } }, body: request })),
  pin: (frame_id: number, solution_id: number) =>
    body(PUT('/api/frames/{frame_id}/operational', { params: { path: { frame_id } }, body: { solution_id } })),
  solution: (solution_id: number, signal?: AbortSignal) =>
    body(GET('/api/solutions/{solution_id}', { params: { path: { solution_id } }, signal })),
  importFrame: (file: File, profile: string) =>
    // OpenAPI describes an uploaded file as a string
    body(POST('/api/frames/import', { body: { file: file as unknown as string, profile }, bodySerializer: multipart })),
  uploadFrame: (frame_id: number, slot: number, solve: boolean) =>
    body(POST('/api/frames/{frame_id}/upload', { params: { path: { frame_id } }, body: { slot, solve } })),
};

const instruments = {
  instruments: () => body(GET('/api/instruments')),
  instrument: (name: string) => body(GET('/api/instruments/{name}', { params: { path: { name } } })),
  instrumentDiff: (old: string, now: string) =>
    body(GET('/api/instruments/diff', { params: { query: { old, new: now } } })),
  checkPackage: (file: File) =>
    body(POST('/api/instruments/check', { body: { file: file as unknown as string }, bodySerializer: multipart })),
  addInstrument: (file: File) =>
    body(POST('/api/instruments', { body: { file: file as unknown as string }, bodySerializer: multipart })),
  newFromPhotographs: (request: Body<'/api/instruments/photographs'>) =>
    body(POST('/api/instruments/photographs', { body: request })),
};

const catalogues = {
  catalogues: () => body(GET('/api/catalogues')),
  catalogue: (catalogue_id: number) =>
    body(GET('/api/catalogues/{catalogue_id}', { params: { path: { catalogue_id } } })),
  catalogueOrbit: (catalogue_id: number) =>
    body(GET('/api/catalogues/{catalogue_id}/orbit', { params: { path: { catalogue_id } } })),
  build: (request: T.CatalogueRequest) => body(POST('/api/catalogues', { body: request })),
  preview: (request: T.CatalogueRequest, ambiguity: boolean, signal?: AbortSignal) =>
    body(
      POST('/api/catalogues/preview', { params: { query: { ambiguity } }, body: request, signal, keepalive: false }),
    ),
  catalogueDiff: (old: number, now: number) =>
    body(GET('/api/catalogues/diff', { params: { query: { old, new: now } } })),
  timeline: (device?: number) => body(GET('/api/catalogues/timeline', { params: { query: given({ device }) } })),
  starLists: () => body(GET('/api/catalogues/sources')),
  addStarList: (file: File, mapping: Record<string, string | number>) =>
    body(
      POST('/api/catalogues/sources', {
        body: { file: file as unknown as string, mapping: JSON.stringify(mapping) },
        bodySerializer: multipart,
      }),
    ),
  listRuns: () => body(GET('/api/lists')),
  listRun: (run_id: number) => body(GET('/api/lists/{run_id}', { params: { path: { run_id } } })),
  listResults: (run_id: number, limit: number, offset: number) =>
    body(GET('/api/lists/{run_id}/results', { params: { path: { run_id }, query: { limit, offset } } })),
  solveLists: (file: File, options: { camera: string; no_distortion: boolean; sigma_px: number }) =>
    body(POST('/api/lists', { body: { file: file as unknown as string, ...options }, bodySerializer: multipart })),
  upload: (catalogue_id: number, bank: string) =>
    body(POST('/api/catalogues/{catalogue_id}/upload', { params: { path: { catalogue_id } }, body: { bank } })),
  sky: (mag = 4.5, at?: string) => body(GET('/api/sky', { params: { query: given({ mag, at }) } })),
  figures: () => body(GET('/api/sky/figures')),
  stars: (q: string, limit: number) => body(GET('/api/stars', { params: { query: { q, limit } } })),
  star: (hip: number) => body(GET('/api/stars/{hip}', { params: { path: { hip } } })),
  helpPages: () => body(GET('/api/help')),
  profiles: () => body(GET('/api/profiles')),
  chains: () => body(GET('/api/chains')),
  chainOptions: (chain: string, profile: string) =>
    body(GET('/api/chains/{chain}/options', { params: { path: { chain }, query: { profile } } })),
  designCameras: () => body(GET('/api/design/cameras')),
  design: (request: T.DesignQuestion, signal?: AbortSignal) =>
    body(POST('/api/design', { body: request, signal, keepalive: false })),
  designSheet: (request: T.DesignQuestion) => body(POST('/api/design/sheet', { body: request })),
  runDesign: (request: T.DesignQuestion) => body(POST('/api/design/run', { body: request })),
};

const transfers = {
  transfers: (limit = 20) => body(GET('/api/transfers', { params: { query: { limit } } })),
  transferAction: (transfer_id: number, action: 'pause' | 'resume' | 'abort') =>
    body(POST(`/api/transfers/{transfer_id}/${action}`, { params: { path: { transfer_id } } })),
  startDownload: (request: Body<'/api/transfers/download'>) => body(POST('/api/transfers/download', { body: request })),
  tables: (kind: TableKind) => body(GET('/api/tables', { params: { query: { kind, limit: 100 } } })),
  tablesOnBoard: () => body(GET('/api/tables/on-board')),
  tableDefaults: (kind: TableKind, profile: string) =>
    body(GET('/api/tables/defaults', { params: { query: { kind, profile } } })),
  addTable: (table: Body<'/api/tables'>) => body(POST('/api/tables', { body: table })),
  uploadTable: (table_id: number, bank: string) =>
    body(POST('/api/tables/{table_id}/upload', { params: { path: { table_id } }, body: { bank } })),
};

const studies = {
  jobs: (limit = 20, kind = '') => body(GET('/api/jobs', { params: { query: { limit, kind } } })),
  job: (job_id: number) => body(GET('/api/jobs/{job_id}', { params: { path: { job_id } } })),
  cancelJob: (job_id: number) => body(POST('/api/jobs/{job_id}/cancel', { params: { path: { job_id } } })),
  experiments: () => body(GET('/api/campaigns/experiments')),
  runExperiments: (request: Body<'/api/campaigns/experiments'>) =>
    body(POST('/api/campaigns/experiments', { body: request })),
  reprocess: (request: Body<'/api/campaigns/reprocess'>) => body(POST('/api/campaigns/reprocess', { body: request })),
  compareChains: () => body(GET('/api/campaigns/chains')),
  chainReport: (pair: { chain: string; version: string } & Query<'/api/campaigns/chains/report'>) =>
    body(GET('/api/campaigns/chains/report', { params: { query: pair } })),
  calibrations: () => body(GET('/api/calibrations')),
  calibration: (calibration_id: number) =>
    body(GET('/api/calibrations/{calibration_id}', { params: { path: { calibration_id } } })),
  calibrate: (request: Body<'/api/calibrations'>) => body(POST('/api/calibrations', { body: request })),
  compareCalibrations: (older: number, newer: number) =>
    body(GET('/api/calibrations/diff', { params: { query: { older, newer } } })),
  useCalibration: (calibration_id: number) =>
    body(POST('/api/calibrations/{calibration_id}/use', { params: { path: { calibration_id } } })),
  useDocumented: (profile: string) => body(POST('/api/calibrations/documented', { body: { profile } })),
  calibrationTable: (calibration_id: number) =>
    body(POST('/api/calibrations/{calibration_id}/table', { params: { path: { calibration_id } } })),
  badPixelTable: (calibration_id: number) =>
    body(POST('/api/calibrations/{calibration_id}/bad-pixel-table', { params: { path: { calibration_id } } })),
  proposeCalibration: (analysis_id: number) =>
    body(POST('/api/analyses/{analysis_id}/calibration', { params: { path: { analysis_id } } })),
  analyses: (kind = '') => body(GET('/api/analyses', { params: { query: { kind } } })),
  sheet: (analysis_id: number) => body(GET('/api/analyses/{analysis_id}/sheet', { params: { path: { analysis_id } } })),
  analysis: (analysis_id: number) => body(GET('/api/analyses/{analysis_id}', { params: { path: { analysis_id } } })),
  analyse: (request: Body<'/api/analyses'>) => body(POST('/api/analyses', { body: request })),
};

const passes = {
  spacecraft: () => body(GET('/api/spacecraft')),
  setOrbit: (orbit: T.OrbitIn) => body(PUT('/api/spacecraft', { body: orbit })),
  stations: () => body(GET('/api/stations')),
  saveStation: (station: T.StationIn, station_id: number | null) =>
    station_id === null
      ? body(POST('/api/stations', { body: station }))
      : body(PUT('/api/stations/{station_id}', { params: { path: { station_id } }, body: station })),
  dropStation: (station_id: number) => body(DELETE('/api/stations/{station_id}', { params: { path: { station_id } } })),
  plans: () => body(GET('/api/pass-plans', { params: { query: { limit: 50 } } })),
  activePlans: () => body(GET('/api/pass-plans/active')),
  addPlan: (plan: T.PlanIn) => body(POST('/api/pass-plans', { body: plan })),
  dropPlan: (plan_id: number) => body(DELETE('/api/pass-plans/{plan_id}', { params: { path: { plan_id } } })),
  armPlan: (plan_id: number, confirm: string[]) =>
    body(POST('/api/pass-plans/{plan_id}/arm', { params: { path: { plan_id } }, body: { confirm } })),
  stopPlan: (plan_id: number) => body(POST('/api/pass-plans/{plan_id}/stop', { params: { path: { plan_id } } })),
  rehearsePlan: (plan_id: number, options: Body<'/api/pass-plans/{plan_id}/rehearsals'>) =>
    body(POST('/api/pass-plans/{plan_id}/rehearsals', { params: { path: { plan_id } }, body: options })),
  rehearsals: (plan_id: number) =>
    body(GET('/api/pass-plans/{plan_id}/rehearsals', { params: { path: { plan_id }, query: { limit: 1 } } })),
  passes: (days: number, station: number | null) => body(GET('/api/passes', { params: { query: { days, station } } })),
};

export const api = {
  ...session,
  ...fleet,
  ...line,
  ...commanding,
  ...views,
  ...handover,
  ...telemetry,
  ...frames,
  ...instruments,
  ...catalogues,
  ...transfers,
  ...studies,
  ...passes,
};

/** What the whole console knows: link, telemetry, commands, transfers, jobs, events. Filled by one stream. */
import { api } from '../api/client';
import type * as T from '../api/types';
import { byUrgency } from '../lib/alarms';
import { problemOf, problemText } from '../lib/problems';
import { hasEnded } from '../lib/stages';
import { session } from './session.svelte';
import { merged, mergedBy, Told } from './snapshot';
import { Stream } from './stream';
import { toast } from './toasts.svelte';

/** A field's own name, whether or not the server wrote its packet before it. */
export function bare(v: { name: string }): string {
  return v.name.slice(v.name.lastIndexOf('.') + 1);
}

export function keyOf(v: { name: string; packet: string }): string {
  return `${v.packet}.${bare(v)}`;
}

const SPARK_POINTS = 60;
const HISTORY = 300;

/* Everything is replaced as a whole and never changed in place: states are raw, or each field of each row would be watched. */
class Live {
  link = $state.raw<T.Link | null>(null);
  dictionary = $state.raw<T.Dictionary | null>(null);
  values = $state.raw<T.Value[]>([]);
  sparks = $state.raw<ReadonlyMap<string, readonly (number | null)[]>>(new Map());
  commands = $state.raw<T.Command[]>([]);
  authority = $state.raw<T.Authority | null>(null);
  /** Open alarms: outside their limits now first, the worst of them first. */
  alarms = $state.raw<T.AlarmRow[]>([]);
  runs = $state.raw<T.StackRun[]>([]);
  schedule = $state.raw<T.Schedule | null>(null);
  onBoardTables = $state.raw<T.OnBoardTable[]>([]);
  limitsTick = $state(0);
  replay = $state.raw<T.Replay | null>(null);
  replayValues = $state.raw<T.Value[]>([]);
  replayLog = $state.raw<{ at: string; text: string; level: string }[]>([]);
  cycles = $state.raw<T.Cycle[]>([]);
  transfers = $state.raw<T.Transfer[]>([]);
  jobs = $state.raw<T.Job[]>([]);
  /** Before that, an empty list of jobs says nothing. */
  jobsRead = $state(false);
  lastEvent = $state.raw<T.EventRow | null>(null);
  latestFrameId = $state<number | null>(null);
  /** The newest frame that the stream announced from the device: nobody need ask for its id. */
  latestDeviceFrame: number | null = null;
  /** Counts up whenever a frame or one of its solutions changed; pages that show frames re-read on it. */
  frameTick = $state(0);
  changedFrame = $state<number | null>(null);
  online = $state(false);
  everOnline = $state(false);
  offlineSince = $state<number | null>(null);
  filled = $state('');
  clockSkewMs = 0;
  private dictionaryTurn = 0;
  private readonly told = new Told();

  /** By plain name; housekeeping wins where several packets carry the same field. */
  readonly byName = $derived(new Map([...this.values].sort((a, b) => Number(a.packet === 'housekeeping') - Number(b.packet === 'housekeeping')).map((v) => [bare(v), v])));
  readonly fields = $derived(new Map((this.dictionary?.telemetry ?? []).map((f) => [keyOf(f), f])));

  value(name: string): number | null {
    const v = this.byName.get(name)?.value;
    return typeof v === 'number' ? v : null;
  }

  put(kind: string, data: unknown): void {
    this.told.note(kind, data);
    switch (kind) {
      case 'link': return this.putLink(data as T.Link);
      case 'telemetry': return this.putTelemetry(data as T.Latest);
      case 'command': return this.putCommand(data as T.Command);
      case 'transfer': this.transfers = unlessEnded(this.transfers, data as T.Transfer); return;
      case 'job': this.jobs = unlessEnded(this.jobs, data as T.Job, false); return;
      case 'cycle': this.putCycle(data as T.Cycle); return;
      case 'event': this.lastEvent = data as T.EventRow; return;
      case 'authority': this.authority = data as T.Authority; return;
      case 'alarm': return this.putAlarm(data as T.AlarmRow);
      case 'stack_run': this.runs = upsert(this.runs, data as T.StackRun); return;
      case 'schedule': this.schedule = data as T.Schedule; return;
      case 'tables': this.onBoardTables = data as T.OnBoardTable[]; return;
      case 'limits': this.limitsTick += 1; return;
      case 'replay': return this.putReplay(data as T.Replay);
      case 'replay.telemetry': this.replayValues = (data as T.Latest).values; return;
      case 'replay.command': { const c = data as { at: string; name: string; stage: string; detail: string }; return this.putReplayed(c.at, `${c.name} ${c.stage}${c.detail ? `: ${c.detail}` : ''}`, c.stage === 'failed' || c.stage === 'rejected' ? 'critical' : 'ok'); }
      case 'replay.event': { const e = data as { at: string; name: string; severity: string; text: string }; return this.putReplayed(e.at, `${e.name} ${e.text}`, e.severity); }
      case 'dropped': void this.load(); return;
      case 'frame': if ((data as T.Frame).source === 'device') this.latestDeviceFrame = Math.max(this.latestDeviceFrame ?? 0, (data as T.Frame).id); return this.putFrame((data as T.Frame).id, true);
      case 'solution': return this.putFrame((data as T.Solution).frame_id, false);
    }
  }

  private putLink(link: T.Link): void {
    this.clockSkewMs = Date.parse(link.utc) - Date.now();
    const changed = this.link?.device_dictionary_hash !== link.device_dictionary_hash || this.link?.dictionary_hash !== link.dictionary_hash;
    const before = this.link;
    this.link = link;
    const state = before !== null && (before.cycle_running !== link.cycle_running || before.mode !== link.mode || before.connected !== link.connected);
    /* The commands' preconditions come with the dictionary, as they are at that moment: they turn with the mode and the cycle. */
    if (state || (changed && this.dictionary?.hash !== link.dictionary_hash)) void this.loadDictionary();
  }

  private putTelemetry(latest: T.Latest): void {
    this.values = latest.values;
    const sparks = new Map(this.sparks);
    for (const v of latest.values) {
      const now = typeof v.value === 'number' && v.state !== 'stale' ? v.value : null;
      sparks.set(keyOf(v), [...(sparks.get(keyOf(v)) ?? []).slice(1 - SPARK_POINTS), now]);
    }
    this.sparks = sparks;
  }

  private putAlarm(alarm: T.AlarmRow): void {
    const before = this.alarms.find((a) => a.id === alarm.id);
    const rest = this.alarms.filter((a) => a.id !== alarm.id);
    this.alarms = alarm.state === 'closed' ? rest : byUrgency([...rest, alarm]);
    if (!before && alarm.state === 'raised' && alarm.worst !== 'watch') toast(alarm.worst === 'critical' ? 'critical' : 'warning', alarm.text, `alarm ${alarm.id}`);
  }

  private putReplay(replay: T.Replay): void {
    if (replay.state === 'none' || replay.contact_id !== this.replay?.contact_id) { this.replayLog = []; this.replayValues = []; }
    this.replay = replay;
  }

  private putReplayed(at: string, text: string, level: string): void {
    this.replayLog = [{ at, text, level }, ...this.replayLog].slice(0, 200);
  }

  private putCycle(cycle: T.Cycle): void {
    this.cycles = [cycle, ...this.cycles.filter((c) => c.iteration !== cycle.iteration)].slice(0, 40);
  }

  putCommand(command: T.Command): void {
    const before = this.commands.find((c) => c.id === command.id);
    if (before && hasEnded(before) && !hasEnded(command)) return; // an answer that comes after the end was told
    this.commands = upsert(this.commands, command).slice(0, HISTORY);
    if (before?.result !== command.result && ['rejected', 'failed', 'unknown'].includes(command.result))
      toast(command.result === 'unknown' ? 'unknown' : 'critical', `${command.name} ${command.result}${command.detail ? `: ${command.detail}` : ''}`, `#${command.request_id}`);
  }

  private putFrame(id: number, isNew: boolean): void {
    if (isNew && (this.latestFrameId === null || id > this.latestFrameId)) this.latestFrameId = id;
    this.changedFrame = id;
    this.frameTick += 1;
  }

  async loadDictionary(): Promise<void> {
    const turn = ++this.dictionaryTurn;
    const read = await api.dictionary().catch(() => null);
    if (read && turn === this.dictionaryTurn) this.dictionary = read;
  }

  /** Reads everything anew. What the stream tells meanwhile is newer, and stays. */
  async load(): Promise<void> {
    this.latestDeviceFrame = null;
    const told = this.told.begin();
    const one = <V>(kind: string, put: (v: V) => void) => (v: V): void => { if (!told.has(kind)) put(v); };
    await Promise.allSettled([
      api.link().then(one('link', (v) => this.putLink(v))),
      this.loadDictionary(),
      api.latest().then(one('telemetry', (v) => this.putTelemetry(v))),
      api.commands(100).then((v) => { this.commands = merged('command', v, this.commands, told); }),
      api.cycles(12).then((v) => { this.cycles = mergedBy((c) => c.iteration, 'cycle', v, this.cycles, told); }),
      api.transfers(20).then((v) => { this.transfers = merged('transfer', v, this.transfers, told); }),
      api.authority().then(one('authority', (v) => { this.authority = v; })),
      api.alarms(true).then((v) => { this.alarms = byUrgency(merged('alarm', v, this.alarms, told)); }),
      api.stackRuns().then((v) => { this.runs = merged('stack_run', v, this.runs, told); }),
      api.schedule().then(one('schedule', (v) => { this.schedule = v; })),
      api.tablesOnBoard().then(one('tables', (v) => { this.onBoardTables = v; })),
      api.replay().then(one('replay', (v) => { this.replay = v; })),
      api.jobs().then((v) => { this.jobs = merged('job', v, this.jobs, told); this.jobsRead = true; }),
    ]);
    this.told.end(told);
    this.frameTick += 1;
  }

  start(): Stream {
    const stream = new Stream(
      {
        open: () => new EventSource('/api/stream'),
        backfill: (after) => api.events(after),
        later: (run, ms) => setTimeout(() => void session.back().then(run), ms),
        now: () => Date.now(),
      },
      {
        item: (kind, data) => this.put(kind, data),
        online: (filled) => {
          this.online = true;
          this.offlineSince = null;
          if (filled) {
            this.filled = filled.count ? `back-filled ${filled.from.slice(11, 19)}Z – ${filled.to.slice(11, 19)}Z` : 'reconnected, nothing missed';
          }
          if (filled || !this.everOnline) void this.load();
          this.everOnline = true;
        },
        offline: (since) => { this.online = false; this.offlineSince = since; if (!this.everOnline) void this.load(); void session.read(); },
      },
    );
    stream.start(); // what is read before it listens could change unseen: everything is read when it does
    return stream;
  }
}

/** The answer to a request may come after the stream has told the end: the end stands. A transfer that goes on starts a new life. */
function unlessEnded<R extends { id: number; finished: string | null; state: string }>(list: R[], item: R, revives = true): R[] {
  const before = list.find((x) => x.id === item.id);
  const stale = before !== undefined && before.finished !== null && item.finished === null && (!revives || item.state === 'queued');
  return stale ? list : upsert(list, item);
}

function upsert<R extends { id: number }>(list: R[], item: R): R[] {
  const at = list.findIndex((x) => x.id === item.id);
  if (at < 0) return [item, ...list];
  return list.map((x, i) => (i === at ? item : x));
}

export const live = new Live();

/** Runs a request, and says in a toast what went wrong. */
export async function attempt<R>(run: () => Promise<R>): Promise<R | null> {
  try {
    return await run();
  } catch (error) {
    toast('critical', problemText(error), problemOf(error).id);
    return null;
  }
}

export async function sendCommand(name: string, args: Record<string, T.ArgumentValue> = {}, confirm = ''): Promise<T.Command | null> {
  const sent = await attempt(() => api.send(name, args, confirm));
  if (sent) live.putCommand(sent);
  return sent;
}

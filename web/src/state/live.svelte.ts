/** Shared state of the console: link, telemetry, commands, transfers, jobs, events. Filled by one stream. */
import { SvelteMap } from 'svelte/reactivity';
import { base } from '../lib/base';
import { api } from '../api/client';
import { sessionHooks } from '../api/http';
import type * as T from '../api/types';
import { byUrgency } from '../lib/alarms';
import { delayed } from '../lib/delayed';
import { problemOf, problemText } from '../lib/problems';
import { commandOrder } from '../lib/requestOrder';
import { hasEnded, isFailure, mergeCommands, resultState, retained } from '../lib/stages';
import { session } from './session.svelte';
import { Batch } from './batch';
import { outageText, type Outage } from './outage';
import { merged, mergedBy, UpdateLog } from './snapshot';
import { Stream, type TopicHandlers } from './stream';
import { unlessEnded, upsert } from './upsert';
import { toast } from './toasts.svelte';

/** Return a field's name without its packet prefix, if it has one. */
export function bare(v: { name: string }): string {
  return v.name.slice(v.name.lastIndexOf('.') + 1);
}

export function keyOf(v: { name: string; packet: string }): string {
  return `${v.packet}.${bare(v)}`;
}

const SPARK_POINTS = 60;
const HISTORY = 300;
const [CHECK_MS, RETRY_MS] = [5000, 5000];

/* Lists are replaced and never changed in place; otherwise each field of each row would be reactive. */
class Live {
  link = $state.raw<T.Link | null>(null);
  dictionary = $state.raw<T.Dictionary | null>(null);
  values = $state.raw<T.Value[]>([]);
  sparks = $state.raw<ReadonlyMap<string, readonly (number | null)[]>>(new Map());
  commands = $state.raw<T.Command[]>([]);
  authority = $state.raw<T.Authority | null>(null);
  /** Open alarms, most urgent first. */
  alarms = $state.raw<T.AlarmRow[]>([]);
  /** True after the first load of the alarms. Before that, an empty list does not mean that there are no alarms. */
  alarmsRead = $state(false);
  schedule = $state.raw<T.Schedule | null>(null);
  /** Tables that the sensor reported; null before the first load. */
  onBoardTables = $state.raw<T.OnBoardTable[] | null>(null);
  limitsTick = $state(0);
  procedureTick = $state(0);
  replay = $state.raw<T.Replay | null>(null);
  replayValues = $state.raw<T.Value[]>([]);
  replayLog = $state.raw<{ at: string; text: string; level: string }[]>([]);
  cycles = $state.raw<T.Cycle[]>([]);
  transfers = $state.raw<T.Transfer[]>([]);
  jobs = $state.raw<T.Job[]>([]);
  /** True after the first load of the jobs. Before that, an empty list does not mean that there are no jobs. */
  jobsRead = $state(false);
  lastEvent = $state.raw<T.EventRow | null>(null);
  latestFrameId = $state<number | null>(null);
  /** Id of the latest device frame that the stream reported; it need not be requested from the server. */
  latestDeviceFrame: number | null = null;
  /** Incremented whenever a frame or one of its solutions changes; pages that show frames reload on it. */
  frameTick = $state(0);
  /** Count of the changes of each frame. */
  readonly frameChanges = new SvelteMap<number, number>();
  /** Count of the loads of all state. A page that shows a frame loads it again. */
  loads = $state(0);
  online = $state(false);
  everOnline = $state(false);
  offlineSince = $state<number | null>(null);
  filled = $state('');
  clockSkewMs = 0;
  private startedBefore: string | null = null;
  /** Load all state again after a failed request. While the page is offline, the next connection loads it. */
  private readonly loadLater = delayed(() => this.online && void this.load(), RETRY_MS);
  private dictionaryGeneration = 0;
  private readonly updates = new UpdateLog();

  /** Values by name without packet. If several packets contain the same field, housekeeping has priority. */
  readonly byName = $derived(
    new Map(
      [...this.values]
        .sort((a, b) => Number(a.packet === 'housekeeping') - Number(b.packet === 'housekeeping'))
        .map((v) => [bare(v), v]),
    ),
  );
  readonly fields = $derived(new Map((this.dictionary?.telemetry ?? []).map((f) => [keyOf(f), f])));

  value(name: string): number | null {
    const v = this.byName.get(name)?.value;
    return typeof v === 'number' ? v : null;
  }

  private readonly topics: TopicHandlers = {
    link: (link) => this.putLink(link),
    telemetry: (latest) => this.putTelemetry(latest),
    command: (command) => this.putReportedCommand(command),
    transfer: (transfer) => (this.transfers = unlessEnded(this.transfers, transfer)),
    job: (job) => (this.jobs = unlessEnded(this.jobs, job, false)),
    cycle: (cycle) => this.putCycle(cycle),
    event: (event) => (this.lastEvent = event),
    authority: (authority) => (this.authority = authority),
    alarm: (alarm) => this.putAlarm(alarm),
    schedule: (schedule) => (this.schedule = schedule),
    tables: (tables) => (this.onBoardTables = tables),
    limits: () => {
      this.limitsTick += 1;
      void this.loadDictionary(); // it has the active limits
    },
    procedure_run: () => (this.procedureTick += 1),
    replay: (replay) => this.putReplay(replay),
    'replay.telemetry': (latest) => (this.replayValues = latest.values),
    'replay.command': (c) =>
      this.putReplayed(
        c.at,
        `${c.name} ${c.stage}${c.detail ? `: ${c.detail}` : ''}`,
        c.stage === 'failed' || c.stage === 'rejected' ? 'critical' : 'ok',
      ),
    'replay.event': (e) => this.putReplayed(e.at, `${e.name} ${e.text}`, e.severity),
    dropped: () => void this.load(),
    frame: (frame) => {
      if (frame.source === 'device') this.latestDeviceFrame = Math.max(this.latestDeviceFrame ?? 0, frame.id);
      this.putFrame(frame.id, true);
    },
    solution: (solution) => this.putFrame(solution.frame_id, false),
    session: () => undefined, // After this message the server ends the stream, and the page reads the session again.
  };

  /** Process a message of the stream. A load in progress does not overwrite it. */
  put<K extends T.Topic>(topic: K, message: T.Topics[K]): void {
    this.updates.note(topic, message);
    this.topics[topic](message);
  }

  private batched(batch: Batch): TopicHandlers {
    const handlers = Object.keys(this.topics).map((topic) => [
      topic,
      (message: never) => {
        if (topic === 'link') this.setClock(message); // now, as alarms for the sound: a hidden tab handles others later
        if (topic === 'alarm') this.put(topic, message);
        else batch.add(() => this.put(topic as T.Topic, message));
      },
    ]);
    return Object.fromEntries(handlers) as TopicHandlers;
  }

  /** Measure the browser's clock against the server's time in a message that has just arrived. */
  private setClock(link: T.Link): void {
    this.clockSkewMs = Date.parse(link.utc) - Date.now();
  }

  private putLink(link: T.Link): void {
    const hashChanged =
      this.link?.device_dictionary_hash !== link.device_dictionary_hash ||
      this.link?.dictionary_hash !== link.dictionary_hash;
    const before = this.link;
    this.link = link;
    const stateChanged =
      before !== null &&
      (before.cycle_running !== link.cycle_running || before.mode !== link.mode || before.connected !== link.connected);
    /* The dictionary contains the preconditions of commands, which change with the mode and the cycle. */
    if (stateChanged || (hashChanged && this.dictionary?.hash !== link.dictionary_hash)) void this.loadDictionary();
    if (before !== null && before.device !== link.device) void this.loadUnknown();
  }

  /** Load the commands of unknown result again: another unit on the line changes which of them can be retried. */
  private async loadUnknown(): Promise<void> {
    for (const c of await api.findCommands({ result: ['unknown'] }).catch(() => [])) this.putCommand(c);
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
    const others = this.alarms.filter((a) => a.id !== alarm.id);
    this.alarms = alarm.state === 'closed' ? others : byUrgency([...others, alarm]);
    if (!before && alarm.state === 'raised' && alarm.worst !== 'watch')
      toast(alarm.worst === 'critical' ? 'critical' : 'warning', alarm.text, `alarm ${alarm.id}`);
  }

  private putReplay(replay: T.Replay): void {
    if (replay.state === 'none' || replay.contact_id !== this.replay?.contact_id) {
      this.replayLog = [];
      this.replayValues = [];
    }
    this.replay = replay;
  }

  private putReplayed(at: string, text: string, level: string): void {
    this.replayLog = [{ at, text, level }, ...this.replayLog].slice(0, 200);
  }

  private putCycle(cycle: T.Cycle): void {
    this.cycles = [cycle, ...this.cycles.filter((c) => c.iteration !== cycle.iteration)].slice(0, 40);
  }

  /** Store a command. Commands that wait on this page are cancelled by a new ABORT of another page or user. */
  private putReportedCommand(command: T.Command): void {
    const isNew = !this.commands.some((c) => c.id === command.id);
    if (command.name === 'ABORT' && isNew && !hasEnded(command)) commandOrder.cancel('ABORT cancelled it');
    this.putCommand(command);
  }

  putCommand(command: T.Command): void {
    const before = this.commands.find((c) => c.id === command.id);
    // A response can arrive after the stream has reported the result.
    if (before && hasEnded(before) && !hasEnded(command)) return;
    this.commands = retained(upsert(this.commands, command), HISTORY);
    if (before?.result === command.result || !isFailure(command)) return;
    const text = `${command.name} ${command.result}${command.detail ? `: ${command.detail}` : ''}`;
    toast(resultState(command), text, `#${command.request_id}`);
  }

  private putFrame(id: number, isNew: boolean): void {
    if (isNew && (this.latestFrameId === null || id > this.latestFrameId)) this.latestFrameId = id;
    this.frameChanges.set(id, (this.frameChanges.get(id) ?? 0) + 1);
    this.frameTick += 1;
  }

  async loadDictionary(): Promise<void> {
    const own = ++this.dictionaryGeneration;
    const dictionary = await api.dictionary().catch(() => void this.loadLater());
    if (dictionary && own === this.dictionaryGeneration) this.dictionary = dictionary;
  }

  /** Reload all state. State that the stream reports during the load is newer and is kept. */
  async load(): Promise<void> {
    this.latestDeviceFrame = null;
    const updates = this.updates.begin();
    const unlessUpdated =
      <V>(kind: string, put: (v: V) => void) =>
      (v: V): void => {
        if (!updates.has(kind)) put(v);
      };
    const parts = await Promise.allSettled([
      api.link().then(
        unlessUpdated('link', (v) => {
          this.setClock(v);
          this.putLink(v);
        }),
      ),
      this.loadDictionary(),
      api.latest().then(unlessUpdated('telemetry', (v) => this.putTelemetry(v))),
      Promise.all([api.commands(100), api.findCommands({ result: ['unknown'] })]).then(([v, unknown]) => {
        this.commands = merged('command', mergeCommands(v, unknown), this.commands, updates);
      }),
      api.cycles(12).then((v) => (this.cycles = mergedBy((c) => c.iteration, 'cycle', v, this.cycles, updates))),
      api.transfers(20).then((v) => (this.transfers = merged('transfer', v, this.transfers, updates))),
      api.authority().then(unlessUpdated('authority', (v) => (this.authority = v))),
      api.alarms(true).then((v) => {
        this.alarms = byUrgency(merged('alarm', v, this.alarms, updates));
        this.alarmsRead = true;
      }),
      api.schedule().then(unlessUpdated('schedule', (v) => (this.schedule = v))),
      api.tablesOnBoard().then(unlessUpdated('tables', (v) => (this.onBoardTables = v))),
      api.replay().then(unlessUpdated('replay', (v) => (this.replay = v))),
      api.jobs().then((v) => {
        this.jobs = merged('job', v, this.jobs, updates);
        this.jobsRead = true;
      }),
    ]);
    this.updates.end(updates);
    if (parts.some((p) => p.status === 'rejected')) this.loadLater();
    this.loads += 1;
    this.frameTick += 1;
  }

  private async describeOutage(events: Outage['events']): Promise<void> {
    const times = { lost_ms: this.offlineSince ?? Date.now(), back_ms: Date.now(), before: this.startedBefore };
    const link = await api.link().catch(() => null);
    this.filled = outageText({ ...times, events, after: link?.server_started ?? null });
  }

  start(): Stream {
    const batch = new Batch(
      {
        hidden: () => document.hidden,
        later: (run, ms) => setTimeout(run, ms),
        frame: (run) => requestAnimationFrame(run),
        now: () => performance.now(),
      },
      () => {
        this.sparks = new Map(); // A curve must not connect points across the gap.
        void this.load();
      },
    );
    document.addEventListener('visibilitychange', () => document.hidden || batch.shown());
    const stream = new Stream(
      {
        open: () => new EventSource(`${base}/api/stream`),
        backfill: (after) => api.events(after),
        later: (run, ms) => setTimeout(() => void session.back().then(run), ms),
        watch: (check) => setInterval(check, CHECK_MS),
        now: () => Date.now(),
      },
      {
        topics: this.batched(batch),
        online: (filled) => {
          batch.drain();
          if (filled) void this.describeOutage(filled);
          if (filled || !this.everOnline) void this.load();
          this.online = this.everOnline = true;
          this.offlineSince = null;
        },
        offline: (since) => {
          this.online = false;
          this.offlineSince = since;
          this.startedBefore = this.link?.server_started ?? null;
          if (!this.everOnline) void this.load();
          void session.read();
        },
      },
    );
    // Data that is loaded before the stream opens could change unnoticed, so all data is loaded when the stream opens.
    stream.start();
    sessionHooks.answered = () => stream.reconnect();
    return stream;
  }
}

export const live = new Live();

/** Run a request. Shows a failure in a toast and returns null. */
export async function attempt<R>(run: () => Promise<R>): Promise<R | null> {
  try {
    return await run();
  } catch (error) {
    toast('critical', problemText(error), problemOf(error).id);
    return null;
  }
}

/** Send a command after the commands that were clicked earlier. */
export async function sendCommand(
  name: string,
  args: Record<string, T.ArgumentValue> = {},
  confirm = '',
): Promise<T.Command | null> {
  const sent = await attempt(() => commandOrder.run(name, () => api.send(name, args, confirm)));
  if (sent) live.putCommand(sent);
  return sent;
}

/** What the whole console knows: link, telemetry, commands, transfers, jobs, events. Filled by one stream. */
import { api, ApiError } from '../api/client';
import type * as T from '../api/types';
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

class Live {
  link = $state<T.Link | null>(null);
  dictionary = $state<T.Dictionary | null>(null);
  values = $state<T.Value[]>([]);
  sparks = $state<Record<string, (number | null)[]>>({});
  commands = $state<T.Command[]>([]);
  cycles = $state<T.Cycle[]>([]);
  transfers = $state<T.Transfer[]>([]);
  jobs = $state<T.Job[]>([]);
  lastEvent = $state<T.EventRow | null>(null);
  latestFrameId = $state<number | null>(null);
  /** Counts up whenever a frame or one of its solutions changed; pages that show frames re-read on it. */
  frameTick = $state(0);
  changedFrame = $state<number | null>(null);
  online = $state(false);
  everOnline = $state(false);
  offlineSince = $state<number | null>(null);
  filled = $state('');
  clockSkewMs = 0;

  /** By plain name; housekeeping wins where several packets carry the same field. */
  readonly byName = $derived(new Map([...this.values].sort((a, b) => Number(a.packet === 'housekeeping') - Number(b.packet === 'housekeeping')).map((v) => [bare(v), v])));
  readonly fields = $derived(new Map((this.dictionary?.telemetry ?? []).map((f) => [keyOf(f), f])));

  value(name: string): number | null {
    const v = this.byName.get(name)?.value;
    return typeof v === 'number' ? v : null;
  }

  put(kind: string, data: unknown): void {
    switch (kind) {
      case 'link': return this.putLink(data as T.Link);
      case 'telemetry': return this.putTelemetry(data as T.Latest);
      case 'command': return this.putCommand(data as T.Command);
      case 'transfer': this.transfers = upsert(this.transfers, data as T.Transfer); return;
      case 'job': this.jobs = upsert(this.jobs, data as T.Job); return;
      case 'cycle': this.putCycle(data as T.Cycle); return;
      case 'event': this.lastEvent = data as T.EventRow; return;
      case 'dropped': void this.load(); return;
      case 'frame': return this.putFrame((data as T.Frame).id, true);
      case 'solution': return this.putFrame((data as T.Solution).frame_id, false);
    }
  }

  private putLink(link: T.Link): void {
    this.clockSkewMs = Date.parse(link.utc) - Date.now();
    const changed = this.link?.device_dictionary_hash !== link.device_dictionary_hash || this.link?.dictionary_hash !== link.dictionary_hash;
    this.link = link;
    if (changed && this.dictionary?.hash !== link.dictionary_hash) void this.loadDictionary();
  }

  private putTelemetry(latest: T.Latest): void {
    this.values = latest.values;
    for (const v of latest.values) {
      const now = typeof v.value === 'number' && v.state !== 'stale' ? v.value : null;
      this.sparks[keyOf(v)] = [...(this.sparks[keyOf(v)] ?? []), now].slice(-SPARK_POINTS);
    }
  }

  private putCycle(cycle: T.Cycle): void {
    this.cycles = [cycle, ...this.cycles.filter((c) => c.iteration !== cycle.iteration)].slice(0, 40);
  }

  putCommand(command: T.Command): void {
    const before = this.commands.find((c) => c.id === command.id);
    if (before && ends(before) && !ends(command)) return;
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
    this.dictionary = await api.dictionary().catch(() => this.dictionary);
  }

  async load(): Promise<void> {
    await Promise.allSettled([
      api.link().then((v) => this.putLink(v)),
      this.loadDictionary(),
      api.latest().then((v) => this.putTelemetry(v)),
      api.commands(100).then((v) => { this.commands = v; }),
      api.cycles(12).then((v) => { this.cycles = v; }),
      api.transfers(20).then((v) => { this.transfers = v; }),
      api.jobs().then((v) => { this.jobs = v; }),
    ]);
    this.frameTick += 1;
  }

  start(): Stream {
    const stream = new Stream(
      {
        open: () => new EventSource('/api/stream'),
        backfill: (after) => api.events(after),
        later: (run, ms) => setTimeout(run, ms),
        now: () => Date.now(),
      },
      {
        item: (kind, data) => this.put(kind, data),
        online: (filled) => {
          this.online = true;
          this.offlineSince = null;
          if (filled) {
            this.filled = filled.count ? `back-filled ${filled.from.slice(11, 19)}Z – ${filled.to.slice(11, 19)}Z` : 'reconnected, nothing missed';
            void this.load();
          }
          this.everOnline = true;
        },
        offline: (since) => { this.online = false; this.offlineSince = since; },
      },
    );
    void this.load();
    stream.start();
    return stream;
  }
}

function ends(c: T.Command): boolean {
  return ['completed', 'rejected', 'failed', 'unknown'].includes(c.result);
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
    toast('critical', error instanceof ApiError ? problemText(error.problem) : String(error), error instanceof ApiError ? error.problem.id : '');
    return null;
  }
}

export function problemText(p: T.Problem): string {
  const parts = [p.message, p.expected && `expected ${p.expected}`, p.got && `got ${p.got}`].filter(Boolean).join(', ');
  return p.hint ? `${parts}. ${p.hint}` : parts;
}

export async function sendCommand(name: string, args: Record<string, T.ArgumentValue> = {}, confirm = ''): Promise<T.Command | null> {
  const sent = await attempt(() => api.send(name, args, confirm));
  if (sent) live.putCommand(sent);
  return sent;
}

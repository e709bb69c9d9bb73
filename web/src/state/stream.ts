/** The one event stream: parses, remembers the last sequence number, reconnects and fetches what it missed. */
import type { EventRow } from '../api/types';

export interface StreamSource {
  onopen: ((e: Event) => void) | null;
  onerror: ((e: Event) => void) | null;
  addEventListener(kind: string, listener: (e: MessageEvent<string>) => void): void;
  close(): void;
}
export interface StreamParts {
  open: (after: number) => StreamSource;
  backfill: (after: number) => Promise<EventRow[]>;
  later: (run: () => void, ms: number) => unknown;
  now: () => number;
}
export interface StreamHandlers {
  item: (kind: string, data: unknown) => void;
  online: (filled: { from: string; to: string; count: number } | null) => void;
  offline: (since: number) => void;
}
export const KINDS = ['link', 'telemetry', 'command', 'transfer', 'frame', 'solution', 'job', 'event', 'cycle', 'dropped', 'authority', 'alarm', 'stack_run', 'schedule', 'tables', 'limits', 'replay', 'replay.telemetry', 'replay.command', 'replay.event', 'session'] as const;
const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 8000;

export class Stream {
  lastSeq = 0;
  /** Count of the newest state message on this connection; 0 before the first, and after an announced loss. */
  private lastCount = 0;
  private source: StreamSource | null = null;
  private wait = FIRST_WAIT_MS;
  private lost: number | null = null;
  private stopped = false;

  constructor(private readonly parts: StreamParts, private readonly handlers: StreamHandlers) {}

  start(): void {
    this.source = this.parts.open(this.lastSeq);
    this.source.onopen = () => void this.opened();
    this.source.onerror = () => this.broke();
    for (const kind of KINDS) this.source.addEventListener(kind, (e) => this.received(kind, e.data, e.lastEventId));
  }

  stop(): void {
    this.stopped = true;
    this.source?.close();
  }

  /** A recorded event counts once, however often it arrives; states always pass. A number that jumps shows a loss: what the record
   *  still has is fetched, and the loss is told even where the server could not say it. `id` is "12" of events, else "12.345". */
  received(kind: string, text: string, id: string): void {
    const data: unknown = JSON.parse(text);
    if (kind === 'event') return this.recorded(data as EventRow);
    if (kind === 'dropped') {
      this.lastCount = 0;
      void this.recover(this.lastSeq, Infinity);
    } else if (id !== '') this.counted(id);
    this.handlers.item(kind, data);
  }

  private recorded(event: EventRow): void {
    const before = this.lastSeq;
    if (!this.fresh(event.seq)) return;
    if (before > 0 && event.seq > before + 1) void this.recover(before, event.seq);
    this.handlers.item('event', event);
  }

  private counted(id: string): void {
    const [seq, count] = id.split('.').map(Number) as [number, number | undefined];
    if (count !== undefined && this.lastCount > 0 && count > this.lastCount + 1) this.handlers.item('dropped', { dropped: count - this.lastCount - 1 });
    this.lastCount = count ?? this.lastCount;
    if (this.lastSeq === 0) this.lastSeq = seq;
  }

  private async recover(after: number, before: number): Promise<void> {
    const missed = await this.parts.backfill(after).catch(() => []);
    for (const e of missed) if (e.seq < before && (before !== Infinity || this.fresh(e.seq))) this.handlers.item('event', e);
  }

  private fresh(seq: number): boolean {
    if (seq <= this.lastSeq) return false;
    this.lastSeq = seq;
    return true;
  }

  private async opened(): Promise<void> {
    this.wait = FIRST_WAIT_MS;
    this.lastCount = 0;
    const wasLost = this.lost !== null;
    this.lost = null;
    if (!wasLost) return this.handlers.online(null);
    const missed = (await this.parts.backfill(this.lastSeq).catch(() => [])).filter((e) => this.fresh(e.seq));
    for (const e of missed) this.handlers.item('event', e);
    const first = missed[0];
    const last = missed[missed.length - 1];
    this.handlers.online(first && last ? { from: first.at, to: last.at, count: missed.length } : { from: '', to: '', count: 0 });
  }

  private broke(): void {
    this.source?.close();
    if (this.lost === null) {
      this.lost = this.parts.now();
      this.handlers.offline(this.lost);
    }
    if (this.stopped) return;
    this.parts.later(() => this.start(), this.wait);
    this.wait = Math.min(LONGEST_WAIT_MS, this.wait * 2);
  }
}

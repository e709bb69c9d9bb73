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
export const KINDS = ['link', 'telemetry', 'command', 'transfer', 'frame', 'solution', 'job', 'event', 'cycle', 'dropped', 'authority', 'alarm', 'stack_run', 'schedule', 'tables', 'limits', 'replay', 'replay.telemetry', 'replay.command', 'replay.event'] as const;
const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 8000;

export class Stream {
  lastSeq = 0;
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

  /** A recorded event counts once, however often it arrives; unnumbered states always pass. */
  received(kind: string, text: string, id: string): void {
    const seq = id === '' ? 0 : Number(id);
    const data: unknown = JSON.parse(text);
    if (kind === 'event' && !this.fresh((data as EventRow).seq)) return;
    if (kind !== 'event' && seq > this.lastSeq) this.lastSeq = seq;
    this.handlers.item(kind, data);
  }

  private fresh(seq: number): boolean {
    if (seq <= this.lastSeq) return false;
    this.lastSeq = seq;
    return true;
  }

  private async opened(): Promise<void> {
    this.wait = FIRST_WAIT_MS;
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

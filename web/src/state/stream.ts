/** The event stream: parses messages, stores the last sequence number, reconnects and fetches missed events. */
import type { EventRow, Topic, Topics } from '../api/types';

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
  /** Call the function every few seconds. */
  watch: (check: () => void) => unknown;
  now: () => number;
}
/** Handlers of the messages, by topic. An unknown or missing topic does not compile. */
export type TopicHandlers = { [K in Topic]: (message: Topics[K]) => void };
export interface StreamHandlers {
  topics: TopicHandlers;
  online: (filled: { from: string; to: string; count: number } | null) => void;
  offline: (since: number) => void;
}
const FIRST_WAIT_MS = 500;
const MAX_WAIT_MS = 8000;
/**
 * The server sends a message every second. After this time without one, the connection is considered lost, because a
 * browser does not notice a lost network for minutes.
 */
export const SILENT_MS = 20_000;

export class Stream {
  lastSeq = 0;
  /** Count of the latest state message on this connection; 0 before the first message and after a reported loss. */
  private lastCount = 0;
  private source: StreamSource | null = null;
  private wait = FIRST_WAIT_MS;
  private lost: number | null = null;
  private stopped = false;
  private heardMs = 0;
  /** True after a failed connection, until the next one is opened. */
  private waiting = false;

  constructor(
    private readonly parts: StreamParts,
    private readonly handlers: StreamHandlers,
  ) {
    parts.watch(() => this.checkSilence());
  }

  start(): void {
    this.waiting = false;
    this.heardMs = this.parts.now();
    this.source = this.parts.open(this.lastSeq);
    this.source.onopen = () => void this.opened();
    this.source.onerror = () => this.failed();
    for (const topic of Object.keys(this.handlers.topics) as Topic[])
      this.source.addEventListener(topic, (e) => this.received(topic, e.data, e.lastEventId));
  }

  /** Connect immediately if the stream waits. Called when the server has answered a request. */
  reconnect(): void {
    if (this.waiting && !this.stopped) this.start();
  }

  stop(): void {
    this.stopped = true;
    this.source?.close();
  }

  private checkSilence(): void {
    const open = this.source !== null && !this.waiting && !this.stopped;
    if (open && this.parts.now() - this.heardMs > SILENT_MS) this.failed();
  }

  /**
   * Process a message. A recorded event is handled once, even if it arrives repeatedly; state messages are always
   * handled. A gap in the numbers shows a loss: recorded events are then fetched, and `dropped` is reported even if the
   * server could not send it. `id` is "12" for recorded events, otherwise "12.345".
   */
  received<K extends Topic>(topic: K, text: string, id: string): void {
    this.heardMs = this.parts.now();
    const message = JSON.parse(text) as Topics[K];
    if (topic === 'event') return this.recorded(message as EventRow);
    if (topic === 'dropped') {
      this.lastCount = 0;
      void this.recover(this.lastSeq, Infinity);
    } else if (id !== '') this.counted(id);
    this.handlers.topics[topic](message);
  }

  private recorded(event: EventRow): void {
    const before = this.lastSeq;
    if (!this.isNew(event.seq)) return;
    if (before > 0 && event.seq > before + 1) void this.recover(before, event.seq);
    this.handlers.topics.event(event);
  }

  private counted(id: string): void {
    const [seq, count] = id.split('.').map(Number) as [number, number | undefined];
    if (count !== undefined && this.lastCount > 0 && count > this.lastCount + 1)
      this.handlers.topics.dropped({ dropped: count - this.lastCount - 1 });
    this.lastCount = count ?? this.lastCount;
    if (this.lastSeq === 0) this.lastSeq = seq;
  }

  private async recover(after: number, before: number): Promise<void> {
    const missed = await this.missed(after);
    for (const e of missed)
      if (e.seq < before && (before !== Infinity || this.isNew(e.seq))) this.handlers.topics.event(e);
  }

  /**
   * Return the recorded events after a number. Events with smaller numbers are of another database, as after a restore:
   * the numbers then continue after the newest of them.
   */
  private async missed(after: number): Promise<EventRow[]> {
    const found = await this.parts.backfill(after).catch(() => []);
    const newest = found[found.length - 1];
    if (!newest || newest.seq > after) return found;
    this.lastSeq = newest.seq;
    return [];
  }

  private isNew(seq: number): boolean {
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
    const source = this.source;
    const found = this.lastSeq > 0 ? await this.missed(this.lastSeq) : [];
    const missed = found.filter((e) => this.isNew(e.seq));
    for (const e of missed) this.handlers.topics.event(e);
    if (this.source !== source || this.waiting) return; // the connection failed meanwhile
    const first = missed[0];
    const last = missed[missed.length - 1];
    this.handlers.online(
      first && last ? { from: first.at, to: last.at, count: missed.length } : { from: '', to: '', count: 0 },
    );
  }

  private failed(): void {
    this.source?.close();
    if (this.lost === null) {
      this.lost = this.parts.now();
      this.handlers.offline(this.lost);
    }
    if (this.stopped) return;
    this.waiting = true;
    this.parts.later(() => this.reconnect(), this.wait);
    this.wait = Math.min(MAX_WAIT_MS, this.wait * 2);
  }
}

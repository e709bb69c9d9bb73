/**
 * Collect the messages of the stream, so that a page is drawn at most four times per second, and never while its tab is
 * hidden.
 */
export interface BatchParts {
  hidden: () => boolean;
  later: (run: () => void, ms: number) => unknown;
  frame: (run: () => void) => unknown;
  now: () => number;
}
/** Messages that the server publishes together arrive within this time. */
export const TOGETHER_MS = 40;
export const MIN_BETWEEN_MS = 250;
/** Maximum number of messages kept for a hidden tab. With more messages, the tab reloads the state when it is shown. */
export const MAX_HELD = 200;

export class Batch {
  private waiting: (() => void)[] = [];
  private overflowed = false;
  private scheduled = false;
  private lastMs = -Infinity;

  constructor(
    private readonly parts: BatchParts,
    private readonly reload: () => void,
  ) {}

  /** Run `handle` at the next drawing, after all handlers that were added before. */
  add(handle: () => void): void {
    if (this.overflowed) return;
    this.waiting.push(handle);
    if (this.parts.hidden()) this.limit();
    else this.schedule();
  }

  /** Draw the collected messages, or reload the state. Call it when the tab is shown again. */
  shown(): void {
    if (this.overflowed) {
      this.overflowed = false;
      this.reload();
    } else if (this.waiting.length) this.schedule();
  }

  /** Handle the collected messages now, also for a hidden tab: they are older than the state that is loaded next. */
  drain(): void {
    const handles = this.waiting;
    this.waiting = [];
    for (const handle of handles) handle();
  }

  private limit(): void {
    if (this.waiting.length <= MAX_HELD) return;
    this.waiting = [];
    this.overflowed = true;
  }

  private schedule(): void {
    if (this.scheduled) return;
    this.scheduled = true;
    const waitMs = Math.max(TOGETHER_MS, this.lastMs + MIN_BETWEEN_MS - this.parts.now());
    this.parts.later(() => this.parts.frame(() => this.flush()), waitMs);
  }

  private flush(): void {
    this.scheduled = false;
    if (this.parts.hidden()) return this.limit();
    this.lastMs = this.parts.now();
    this.drain();
  }
}

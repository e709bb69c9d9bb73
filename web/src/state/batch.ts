/**
 * Collects the messages of the stream, so that a page is drawn at most four times a second and not at all while its tab
 * is hidden.
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
/** If a hidden tab misses more messages, it reloads the state when it is shown. */
export const MAX_HELD = 200;

export class Batch {
  private waiting: (() => void)[] = [];
  private overflowed = false;
  private planned = false;
  private lastMs = -Infinity;

  constructor(
    private readonly parts: BatchParts,
    private readonly reload: () => void,
  ) {}

  /** Run `handle` with the next drawing, after everything that was added before. */
  add(handle: () => void): void {
    if (this.overflowed) return;
    this.waiting.push(handle);
    if (this.parts.hidden()) this.limit();
    else this.plan();
  }

  /** Call when the tab is shown again. */
  shown(): void {
    if (this.overflowed) {
      this.overflowed = false;
      this.reload();
    } else if (this.waiting.length) this.plan();
  }

  private limit(): void {
    if (this.waiting.length <= MAX_HELD) return;
    this.waiting = [];
    this.overflowed = true;
  }

  private plan(): void {
    if (this.planned) return;
    this.planned = true;
    const waitMs = Math.max(TOGETHER_MS, this.lastMs + MIN_BETWEEN_MS - this.parts.now());
    this.parts.later(() => this.parts.frame(() => this.flush()), waitMs);
  }

  private flush(): void {
    this.planned = false;
    if (this.parts.hidden()) return this.limit();
    this.lastMs = this.parts.now();
    const handles = this.waiting;
    this.waiting = [];
    for (const handle of handles) handle();
  }
}

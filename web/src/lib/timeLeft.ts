/**
 * Time left of long work, from the progress that this page has seen: work that waited in a queue or was resumed after a
 * restart did not progress since its creation.
 */
export class TimeLeft {
  private first: { id: unknown; done: number; atMs: number } | null = null;

  /** Seconds left; null before the first progress of this work, and once it is complete. */
  estimate(id: unknown, done: number, total: number, nowMs: number): number | null {
    if (this.first === null || this.first.id !== id || done < this.first.done) this.first = { id, done, atMs: nowMs };
    const progress = done - this.first.done;
    if (progress === 0 || done >= total) return null;
    return ((nowMs - this.first.atMs) / 1000 / progress) * (total - done);
  }
}

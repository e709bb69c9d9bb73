/**
 * Estimate the remaining time of long work from the progress seen by this page. The creation time cannot be used,
 * because the work may have waited in a queue or been resumed after a restart.
 */
export class TimeLeft {
  private first: { id: unknown; done: number; atMs: number } | null = null;

  /** Return the remaining time in seconds; null before the first progress, and when the work is complete. */
  estimate(id: unknown, done: number, total: number, nowMs: number): number | null {
    if (this.first === null || this.first.id !== id || done < this.first.done) this.first = { id, done, atMs: nowMs };
    const progress = done - this.first.done;
    if (progress === 0 || done >= total) return null;
    return ((nowMs - this.first.atMs) / 1000 / progress) * (total - done);
  }
}

/** Queue of image files, uploaded one after another. It continues while other pages are open. */
import { ApiError, api } from '../../api/client';
import type { FrameDetail } from '../../api/types';
import { problemText } from '../../lib/problems';
import { TimeLeft } from '../../lib/timeLeft';

const IMAGES = /\.(fits?|fts|png|tiff?|jpe?g)$/i;

const byName = new Intl.Collator('en', { numeric: true });
const nameOf = (file: File): string => file.webkitRelativePath || file.name;

export interface RejectedFile {
  file: File;
  profile: string;
  reason: string;
}

interface WaitingFile {
  file: File;
  profile: string;
}

/**
 * True if the error concerns only this file. False if the next file would fail for the same reason: no answer, signed
 * out, too many requests, or a server error.
 */
function concernsTheFile(error: unknown): boolean {
  return (
    error instanceof ApiError && error.status >= 400 && error.status < 500 && ![401, 403, 429].includes(error.status)
  );
}

export class ImportQueue {
  waiting = $state.raw<WaitingFile[]>([]);
  sending = $state.raw<WaitingFile | null>(null);
  rejected = $state.raw<RejectedFile[]>([]);
  stored = $state.raw<FrameDetail[]>([]);
  /** Number of files of other types, which were not sent. */
  leftOut = $state(0);
  /** Reason why the queue waits for the user; empty while it runs. */
  stopped = $state('');
  left = $state<number | null>(null);
  readonly total = $derived(this.waiting.length + (this.sending ? 1 : 0) + this.rejected.length + this.stored.length);
  readonly working = $derived(this.sending !== null);
  private readonly estimate = new TimeLeft();
  private batch = 0;

  constructor(private readonly send: (file: File, profile: string) => Promise<FrameDetail>) {}

  /**
   * Add files in the order of their names, because a browser returns the files of a folder in no order and a night is
   * numbered. If the queue has ended, its results are cleared first.
   */
  add(files: readonly File[], profile: string): void {
    if (!this.sending && !this.waiting.length) this.clear();
    const images = files.filter((file) => IMAGES.test(file.name)).sort((a, b) => byName.compare(nameOf(a), nameOf(b)));
    this.leftOut += files.length - images.length;
    this.waiting = [...this.waiting, ...images.map((file) => ({ file, profile }))];
    void this.work();
  }

  /** Continue after a connection loss. */
  resume(): void {
    void this.work();
  }

  /** Upload the rejected files again. */
  retry(): void {
    this.waiting = [...this.waiting, ...this.rejected.map(({ file, profile }) => ({ file, profile }))];
    this.rejected = [];
    void this.work();
  }

  /** Discard the waiting files. The file in progress is completed. */
  cancel(): void {
    this.waiting = [];
    this.stopped = '';
  }

  /** Clear the results. */
  clear(): void {
    [this.rejected, this.stored, this.leftOut, this.stopped, this.left] = [[], [], 0, '', null];
    this.batch += 1;
  }

  private async work(): Promise<void> {
    if (this.sending) return;
    this.stopped = '';
    for (let next = this.waiting[0]; next; next = this.waiting[0]) {
      this.waiting = this.waiting.slice(1);
      this.sending = next;
      try {
        const frame = await this.send(next.file, next.profile);
        this.stored = [...this.stored, frame];
      } catch (error) {
        if (concernsTheFile(error)) this.rejected = [...this.rejected, { ...next, reason: problemText(error) }];
        else {
          this.waiting = [next, ...this.waiting];
          this.stopped = problemText(error);
        }
      }
      this.sending = null;
      this.left = this.estimate.estimate(
        this.batch,
        this.rejected.length + this.stored.length,
        this.total,
        performance.now(),
      );
      if (this.stopped) return;
    }
  }
}

export const importQueue = new ImportQueue((file, profile) => api.importFrame(file, profile));

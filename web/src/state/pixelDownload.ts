/** A download of the pixels and the histogram of a frame. */
import { api } from '../api/client';
import { rawPixels, type RawImage } from '../api/pixels';
import type { Histogram } from '../api/types';
import type { Received } from '../lib/received';

export class PixelDownload {
  readonly result: Promise<[RawImage, Histogram]>;
  private sha256: string | null = null;
  private readonly controller = new AbortController();

  constructor(
    readonly frameId: number,
    report: (received: Received) => void,
  ) {
    const observer = { signal: this.controller.signal, began: (hash: string) => (this.sha256 = hash), report };
    this.result = Promise.all([rawPixels(frameId, observer), api.histogram(frameId)]);
    this.result.catch(() => (this.sha256 = null));
  }

  /** True if these pixels are being received or were received. False after a failure. */
  contains(sha256: string): boolean {
    return this.sha256 === sha256;
  }

  /** End the download, so that it does not delay others. */
  cancel(): void {
    this.controller.abort();
  }
}

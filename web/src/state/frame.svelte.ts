/** The displayed frame: details, raw pixels, histogram, chosen solution, selected star and stretch. */
import { api } from '../api/client';
import type { RawImage } from '../api/pixels';
import type { FrameDetail, Histogram, SolutionDetail } from '../api/types';
import { problemText } from '../lib/problems';
import { receivedWords, type Received } from '../lib/received';
import type { Stretch } from '../sky/stretch';
import { live } from './live.svelte';
import { PixelDownload } from './pixelDownload';
import { view } from './view.svelte';

/** Return the id of the device's latest frame, or of the latest imported frame if there is no device frame. */
async function latestId(): Promise<number | null> {
  if (live.latestDeviceFrame !== null) return live.latestDeviceFrame;
  const device = await api.frames({ limit: 1, source: 'device' });
  const page = device.frames.length ? device : await api.frames({ limit: 1 });
  return page.frames[0]?.id ?? null;
}

const LIVE_WITHIN_MS = 10_000;
/** Time after the results of a chosen frame in which its pixels are displayed together with them. */
const PIXELS_WITHIN_MS = 250;

/** True if the promise is settled within this time. */
function settles(promise: Promise<unknown>, ms: number): Promise<boolean> {
  const done = (): boolean => true;
  return Promise.race([promise.then(done, done), new Promise<boolean>((r) => setTimeout(() => r(false), ms))]);
}

export class FrameView {
  detail = $state.raw<FrameDetail | null>(null);
  image = $state.raw<RawImage | null>(null);
  histogram = $state.raw<Histogram | null>(null);
  solution = $state.raw<SolutionDetail | null>(null);
  selected = $state<number | null>(null);
  /** A position for the pixel inspector that is not a centroid. */
  look = $state<{ col: number; row: number } | null>(null);
  /** The last frame with a ground result, shown beside the image while the latest frame is being solved. */
  lastSolved = $state.raw<{ detail: FrameDetail; solution: SolutionDetail | null } | null>(null);
  /** The solution shown before a preview (a result that is not stored). Undefined if no preview is open. */
  beforePreview = $state.raw<SolutionDetail | null | undefined>(undefined);
  problem = $state('');
  loading = $state(false);
  /** Received bytes of the pixels that are loaded; null if the load is short or complete. */
  private received = $state.raw<Received | null>(null);
  readonly progress = $derived(this.received ? receivedWords(this.received) : '');
  stretch = $state<Stretch>({ low: 0, high: 255, kind: 'asinh', invert: view.theme === 'light' });
  /** Milliseconds from the storage of the frame to the display of its pixels. */
  latencyMs = $state<number | null>(null);
  private shown: string | null = null;
  private download: PixelDownload | null = null;
  private arrived: { image: RawImage; at: number } | null = null;
  private generation = 0;
  private choices = 0;
  /** Not reactive, so that an effect that starts a load does not run again when the load starts. */
  private busy = false;
  private following = false;
  private loadAgain = false;

  /**
   * Load a frame, or the latest one. The pixels are loaded only if they differ, and a download that has begun continues
   * when the frame gets another result. The results of a chosen frame do not wait for slow pixels. The latest frame is
   * shown complete, because the previous one stays until then.
   */
  async load(id: number | 'latest'): Promise<void> {
    // Frames can arrive faster than they are loaded. The frame in progress is then shown first, and afterwards the
    // latest frame.
    if (id === 'latest' && this.busy && this.following) {
      this.loadAgain = true;
      return;
    }
    this.following = id === 'latest';
    this.busy = true;
    await this.read(id);
    this.busy = false;
    if (!this.loadAgain) return;
    this.loadAgain = false;
    await this.load('latest');
  }

  private async read(id: number | 'latest'): Promise<void> {
    const own = ++this.generation;
    this.loading = true;
    let detail: FrameDetail | null = null;
    try {
      const frameId = id === 'latest' ? await latestId() : id;
      if (own !== this.generation) return;
      if (frameId === null) {
        this.detail = null;
        this.problem = '';
        return;
      }
      const isOther = frameId !== this.detail?.id;
      const isMissing = isOther || !this.image;
      if (isOther) this.problem = '';
      if (this.download?.frameId !== frameId) this.endDownload();
      const running = this.download;
      const started = isOther && !running ? this.startDownload(frameId) : null;
      detail = await api.frame(frameId);
      if (own !== this.generation) return;
      const continued = running?.contains(detail.sha256) ? running : null;
      const download = started ?? continued ?? (isMissing ? this.startDownload(frameId) : null);
      const isSlow = download !== null && !(await settles(download.result, PIXELS_WITHIN_MS));
      if (own !== this.generation) return;
      if (id !== 'latest' && isSlow && isMissing) {
        this.image = this.histogram = this.shown = null;
        this.showResults(detail, id);
      }
      await this.showPixels(detail, download, own);
      if (own === this.generation) this.showResults(detail, id);
    } catch (error) {
      if (own !== this.generation) return;
      this.endDownload();
      if (id !== 'latest' && this.detail?.id !== id) this.clear();
      if (id !== 'latest' && detail) this.showResults(detail, id); // the pixels can have been removed
      this.problem = problemText(error);
    } finally {
      if (own === this.generation) this.loaded();
    }
  }

  private clear(): void {
    this.detail = this.image = this.histogram = this.solution = this.selected = this.shown = null;
    this.beforePreview = undefined;
  }

  private showResults(detail: FrameDetail, id: number | 'latest'): void {
    const same = this.detail?.id === detail.id;
    this.detail = detail;
    this.problem = '';
    if (!same) this.beforePreview = undefined;
    if (same && this.beforePreview !== undefined) return;
    const chosen = same && this.solution ? detail.solutions.find((s) => s.id === this.solution?.id) : undefined;
    if (!chosen || chosen.origin === 'on board') this.solution = detail.ground ?? detail.on_board;
    if (detail.ground?.attitude) this.lastSolved = { detail, solution: this.solution };
    else if (id !== 'latest') this.lastSolved = null;
    if (!same) this.selected = null;
  }

  /** Discard the load in progress. The displayed frame stays. */
  stop(): void {
    this.generation += 1;
    this.loadAgain = false;
    this.endDownload();
    this.loaded();
  }

  private loaded(): void {
    this.loading = false;
    this.received = null;
  }

  /** Download the pixels of a frame instead of those that are being downloaded. */
  private startDownload(id: number): PixelDownload {
    this.endDownload();
    const download = new PixelDownload(id, (received) => {
      if (download === this.download) this.received = received;
    });
    this.download = download;
    return download;
  }

  private endDownload(): void {
    this.download?.cancel();
    this.download = null;
  }

  private async showPixels(detail: FrameDetail, download: PixelDownload | null, own: number): Promise<void> {
    const key = `${detail.id} ${detail.sha256} ${detail.rows_held.map((r) => r.join('-')).join(',')}`;
    if (key === this.shown) return;
    const [image, histogram] = await (download ?? this.startDownload(detail.id)).result;
    if (own !== this.generation) return;
    const previous = this.shown;
    this.download = null;
    this.image = image;
    this.histogram = histogram;
    this.stretch = { ...this.stretch, low: histogram.low, high: histogram.high };
    this.shown = key;
    if (previous !== null) this.arrived = { image, at: Date.parse(detail.received) };
  }

  /**
   * Measure the time since the frame was complete on the ground. Called when the image is on the canvas; only frames
   * received while the page is open are measured.
   */
  drawn(image: RawImage): void {
    const arrived = this.arrived;
    if (!arrived || arrived.image !== image) return;
    this.arrived = null;
    requestAnimationFrame(() => {
      const ms = Date.now() + live.clockSkewMs - arrived.at;
      if (ms < LIVE_WITHIN_MS) this.latencyMs = Math.max(0, Math.round(ms));
    });
  }

  /** Show a result that is not stored. Null hides it; the previous solution is kept for `endPreview`. */
  preview(result: SolutionDetail | null): void {
    if (this.beforePreview === undefined) this.beforePreview = this.solution;
    this.solution = result;
    this.selected = null;
  }

  /** Return to the solution that was shown before the preview. */
  endPreview(): void {
    if (this.beforePreview === undefined) return;
    this.solution = this.beforePreview;
    this.beforePreview = undefined;
    this.selected = null;
  }

  async choose(solutionId: number): Promise<void> {
    this.beforePreview = undefined;
    const [d, own] = [this.detail, ++this.choices];
    const stored = [d?.ground, d?.on_board].find((s) => s?.id === solutionId) ?? (await api.solution(solutionId));
    if (own !== this.choices || d?.id !== this.detail?.id) return; // another result or frame was chosen meanwhile
    this.solution = stored;
    this.selected = null;
  }
}

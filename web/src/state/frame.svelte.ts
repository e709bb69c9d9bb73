/** The displayed frame: detail, raw pixels, histogram, chosen solution, selected star, stretch. */
import { api, type RawImage } from '../api/client';
import type { FrameDetail, Histogram, SolutionDetail } from '../api/types';
import { problemText } from '../lib/problems';
import type { Stretch } from '../sky/stretch';
import { live } from './live.svelte';
import { view } from './view.svelte';

/** The newest frame of the device, or the newest imported one if the device has none. */
async function newest(): Promise<number | null> {
  if (live.latestDeviceFrame !== null) return live.latestDeviceFrame;
  const device = await api.frames({ limit: 1, source: 'device' });
  const any = device.frames.length ? device : await api.frames({ limit: 1 });
  return any.frames[0]?.id ?? null;
}

const LIVE_WITHIN_MS = 10_000;

export class FrameView {
  detail = $state.raw<FrameDetail | null>(null);
  image = $state.raw<RawImage | null>(null);
  histogram = $state.raw<Histogram | null>(null);
  solution = $state.raw<SolutionDetail | null>(null);
  selected = $state<number | null>(null);
  /** A position without a centroid for the pixel inspector. */
  look = $state<{ col: number; row: number } | null>(null);
  /** The last frame with a ground result: shown beside the image while the newest one is being solved. */
  lastSolved = $state.raw<{ detail: FrameDetail; solution: SolutionDetail | null } | null>(null);
  /** The solution shown before a preview, which is a result that is not stored; undefined: no preview is open. */
  beforePreview = $state.raw<SolutionDetail | null | undefined>(undefined);
  problem = $state('');
  loading = $state(false);
  stretch = $state<Stretch>({ low: 0, high: 255, kind: 'asinh', invert: view.theme === 'light' });
  /** Milliseconds from storage of the frame to its pixels on this screen. */
  latencyMs = $state<number | null>(null);
  private shown: string | null = null;
  private arrived: { image: RawImage; at: number } | null = null;
  private generation = 0;
  /** Not reactive: an effect that starts a load must not run again because the load has started. */
  private busy = false;
  private following = false;
  private loadAgain = false;

  /** Loads a frame, or the newest one; pixels only if they differ. */
  async load(id: number | 'latest'): Promise<void> {
    // Frames may arrive faster than one is loaded: the one being loaded is shown, then the newest of those received
    // in the meantime.
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
    const turn = ++this.generation;
    this.loading = true;
    try {
      const wantedId = id === 'latest' ? await newest() : id;
      if (turn !== this.generation) return;
      if (wantedId === null) {
        this.detail = null;
        this.problem = '';
        return;
      }
      // New pixels are loaded together with the results computed from them.
      const ahead = wantedId === this.detail?.id ? null : this.readPixels(wantedId);
      ahead?.catch(() => undefined);
      const detail = await api.frame(wantedId);
      if (turn !== this.generation) return;
      await this.showPixels(detail, ahead, turn);
      if (turn !== this.generation) return;
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
    } catch (error) {
      if (turn !== this.generation) return;
      this.problem = problemText(error);
    } finally {
      if (turn === this.generation) this.loading = false;
    }
  }

  /** Discard the load in progress; the displayed frame stays. */
  stop(): void {
    this.generation += 1;
    this.loadAgain = false;
    this.loading = false;
  }

  private readPixels(id: number): Promise<[RawImage, Histogram]> {
    return Promise.all([api.raw(id), api.histogram(id)]);
  }

  private async showPixels(
    detail: FrameDetail,
    ahead: Promise<[RawImage, Histogram]> | null,
    turn: number,
  ): Promise<void> {
    const key = `${detail.id} ${detail.sha256} ${detail.rows_held.map((r) => r.join('-')).join(',')}`;
    if (key === this.shown) return;
    const [image, histogram] = await (ahead ?? this.readPixels(detail.id));
    if (turn !== this.generation) return;
    const first = this.shown;
    this.image = image;
    this.histogram = histogram;
    this.stretch = { ...this.stretch, low: histogram.low, high: histogram.high };
    this.shown = key;
    if (first !== null) this.arrived = { image, at: Date.parse(detail.received) };
  }

  /**
   * Called when the image is on the canvas: measures the time since the frame was complete on the ground, only for one
   * received while the page was open.
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

  /** Show a result that is not stored, or switch between it and the previous solution. */
  preview(result: SolutionDetail | null): void {
    if (this.beforePreview === undefined) this.beforePreview = this.solution;
    this.solution = result;
    this.selected = null;
  }

  /** Return to the solution before the preview. */
  endPreview(): void {
    if (this.beforePreview === undefined) return;
    this.solution = this.beforePreview;
    this.beforePreview = undefined;
    this.selected = null;
  }

  async choose(solutionId: number): Promise<void> {
    this.beforePreview = undefined;
    const d = this.detail;
    if (d?.ground?.id === solutionId) this.solution = d.ground;
    else if (d?.on_board?.id === solutionId) this.solution = d.on_board;
    else this.solution = await api.solution(solutionId);
    this.selected = null;
  }
}

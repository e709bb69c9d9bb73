/** One frame on show: detail, raw pixels, histogram, chosen solution, selected star, stretch. */
import { api, ApiError, type RawImage } from '../api/client';
import type { FrameDetail, Histogram, SolutionDetail } from '../api/types';
import type { Stretch } from '../sky/stretch';
import { problemText } from './live.svelte';
import { view } from './view.svelte';

/** The newest frame of the device; an imported one only while the device has given none. */
async function newest(): Promise<number | null> {
  const device = await api.frames({ limit: 1, source: 'device' });
  const any = device.frames.length ? device : await api.frames({ limit: 1 });
  return any.frames[0]?.id ?? null;
}

export class FrameView {
  detail = $state<FrameDetail | null>(null);
  image = $state.raw<RawImage | null>(null);
  histogram = $state.raw<Histogram | null>(null);
  solution = $state.raw<SolutionDetail | null>(null);
  selected = $state<number | null>(null);
  /** A place without a centroid that the inspector should show. */
  look = $state<{ col: number; row: number } | null>(null);
  problem = $state('');
  loading = $state(false);
  stretch = $state<Stretch>({ low: 0, high: 255, kind: 'asinh', invert: view.theme === 'light' });
  private shown: string | null = null;
  private generation = 0;
  /** No state: an effect that starts a reading must not run again because the reading has begun. */
  private busy = false;
  private following = false;
  private again = false;

  /** Reads a frame, or the newest one; pixels only when they are other pixels. */
  async load(id: number | 'latest'): Promise<void> {
    // Frames may come faster than one is read: what is being read is shown, then the newest of those that came meanwhile.
    if (id === 'latest' && this.busy && this.following) { this.again = true; return; }
    this.following = id === 'latest';
    this.busy = true;
    await this.read(id);
    this.busy = false;
    if (!this.again) return;
    this.again = false;
    await this.load('latest');
  }

  private async read(id: number | 'latest'): Promise<void> {
    const turn = ++this.generation;
    this.loading = true;
    try {
      const wanted = id === 'latest' ? await newest() : id;
      if (turn !== this.generation) return;
      if (wanted === null) { this.detail = null; this.problem = ''; return; }
      const detail = await api.frame(wanted);
      if (turn !== this.generation) return;
      await this.loadPixels(detail);
      if (turn !== this.generation) return;
      const same = this.detail?.id === detail.id;
      this.detail = detail;
      this.problem = '';
      const chosen = same && this.solution ? detail.solutions.find((s) => s.id === this.solution?.id) : undefined;
      if (!chosen || chosen.origin === 'on board' ) this.solution = detail.ground ?? detail.on_board;
      if (!same) this.selected = null;
    } catch (error) {
      if (turn !== this.generation) return;
      this.problem = error instanceof ApiError ? problemText(error.problem) : String(error);
    } finally {
      if (turn === this.generation) this.loading = false;
    }
  }

  private async loadPixels(detail: FrameDetail): Promise<void> {
    const key = `${detail.id} ${detail.sha256} ${detail.rows_held.map((r) => r.join('-')).join(',')}`;
    if (key === this.shown) return;
    const [image, histogram] = await Promise.all([api.raw(detail.id), api.histogram(detail.id)]);
    this.image = image;
    this.histogram = histogram;
    this.stretch = { ...this.stretch, low: histogram.low, high: histogram.high };
    this.shown = key;
  }

  async choose(solutionId: number): Promise<void> {
    const d = this.detail;
    if (d?.ground?.id === solutionId) this.solution = d.ground;
    else if (d?.on_board?.id === solutionId) this.solution = d.on_board;
    else this.solution = await api.solution(solutionId);
    this.selected = null;
  }
}

/** The catalogue builder's form as text, its checks, and the live preview. */
import { api, ApiError } from '../api/client';
import type { CatalogueDetail, CatalogueIn, Preview } from '../api/types';
import { short } from '../lib/format';
import { problemText } from './live.svelte';

export interface NumberField { key: keyof Texts; label: string; unit: string; min: number; max: number }
export interface Texts {
  inclination_deg: string; raan_from: string; raan_to: string; days: string; roll: string; pitch: string; yaw: string; margin_deg: string;
  faint_mag: string; bright_mag: string; min_separation_deg: string; brightest_per_field: string; pair_min_deg: string; pair_max_deg: string;
}
const LIMITS: Record<keyof Texts, [number, number]> = {
  inclination_deg: [0, 180], raan_from: [0, 360], raan_to: [0, 360], days: [0.1, 400], roll: [0, 180], pitch: [0, 180], yaw: [0, 180], margin_deg: [0, 20],
  faint_mag: [-2, 8], bright_mag: [-3, 8], min_separation_deg: [0, 5], brightest_per_field: [0, 500], pair_min_deg: [0, 20], pair_max_deg: [0.1, 120],
};
const WAIT_MS = 350;
const START: Texts = {
  inclination_deg: '97.6', raan_from: '0', raan_to: '360', days: '14', roll: '5', pitch: '5', yaw: '5', margin_deg: '0.5',
  faint_mag: '3.8', bright_mag: '-2', min_separation_deg: '0', brightest_per_field: '0', pair_min_deg: '0.25', pair_max_deg: '',
};

export class Builder {
  /** What a new catalogue starts with. */
  readonly first = START;
  texts = $state<Texts>({ ...START });
  name = $state('');
  profile = $state('cubestar');
  format = $state('cubestar');
  orbit = $state<CatalogueIn['orbit']>('none');
  tle = $state('');
  start = $state('');
  pointing = $state<CatalogueIn['pointing']>('zenith');
  dropVariables = $state(false);
  preview = $state.raw<Preview | null>(null);
  problem = $state('');
  busy = $state(false);
  private stop: AbortController | null = null;
  private timer: ReturnType<typeof setTimeout> | null = null;

  rangeOf(key: keyof Texts): string {
    const [a, b] = LIMITS[key];
    return `${short(a)} – ${short(b)}`;
  }

  problemOf(key: keyof Texts): string {
    const text = this.texts[key];
    if (key === 'pair_max_deg' && text.trim() === '') return '';
    const [a, b] = LIMITS[key];
    const v = number(text);
    return Number.isFinite(v) && v >= a && v <= b ? '' : `${short(a)} – ${short(b)}, got ${text || 'nothing'}`;
  }

  get valid(): boolean {
    return (Object.keys(LIMITS) as (keyof Texts)[]).every((k) => this.problemOf(k) === '') && (this.orbit !== 'tle' || this.tle.trim() !== '');
  }

  get request(): CatalogueIn {
    const t = this.texts;
    const both = (text: string): [number, number] => [-number(text), number(text)];
    return {
      name: this.name, profile: this.profile, format: this.format, orbit: this.orbit, inclination_deg: number(t.inclination_deg), raan_deg: [number(t.raan_from), number(t.raan_to)], tle: this.tle,
      start: this.start, days: number(t.days), pointing: this.pointing, roll_deg: both(t.roll), pitch_deg: both(t.pitch), yaw_deg: both(t.yaw), margin_deg: number(t.margin_deg),
      faint_mag: number(t.faint_mag), bright_mag: number(t.bright_mag), min_separation_deg: number(t.min_separation_deg), brightest_per_field: Math.round(number(t.brightest_per_field)),
      drop_variables: this.dropVariables, pair_min_deg: number(t.pair_min_deg), pair_max_deg: t.pair_max_deg.trim() ? number(t.pair_max_deg) : null,
    };
  }

  /** Takes over what an existing catalogue was asked for. */
  fill(detail: CatalogueDetail): void {
    const r = detail.request as Partial<CatalogueIn>;
    const text = (v: unknown, old: string): string => (v === undefined || v === null ? old : String(v));
    this.name = detail.name;
    this.profile = detail.profile;
    this.format = detail.format;
    this.orbit = r.orbit ?? 'none';
    this.tle = r.tle ?? '';
    this.start = r.start ?? '';
    this.pointing = r.pointing ?? 'zenith';
    this.dropVariables = r.drop_variables ?? false;
    this.texts = {
      inclination_deg: text(r.inclination_deg, START.inclination_deg), raan_from: text(r.raan_deg?.[0], START.raan_from), raan_to: text(r.raan_deg?.[1], START.raan_to), days: text(r.days, START.days),
      roll: text(r.roll_deg?.[1], START.roll), pitch: text(r.pitch_deg?.[1], START.pitch), yaw: text(r.yaw_deg?.[1], START.yaw), margin_deg: text(r.margin_deg, START.margin_deg),
      faint_mag: text(r.faint_mag, START.faint_mag), bright_mag: text(r.bright_mag, START.bright_mag), min_separation_deg: text(r.min_separation_deg, START.min_separation_deg),
      brightest_per_field: text(r.brightest_per_field, START.brightest_per_field), pair_min_deg: text(r.pair_min_deg, START.pair_min_deg), pair_max_deg: text(r.pair_max_deg, ''),
    };
    this.preview = null;
    this.problem = '';
  }

  /** Asks for a preview a little after the last change; an older answer never overwrites a newer one. */
  changed(): void {
    if (this.timer) clearTimeout(this.timer);
    this.stop?.abort();
    if (!this.valid) return;
    this.timer = setTimeout(() => void this.ask(), WAIT_MS);
  }

  private async ask(): Promise<void> {
    const stop = new AbortController();
    this.stop = stop;
    this.busy = true;
    try {
      this.preview = await api.preview(this.request, stop.signal);
      this.problem = '';
    } catch (e) {
      if (stop.signal.aborted) return;
      this.problem = e instanceof ApiError ? problemText(e.problem) : String(e);
    } finally {
      if (!stop.signal.aborted) this.busy = false;
    }
  }
}

function number(text: string): number {
  return text.trim() === '' ? NaN : Number(text.replace('\u2212', '-'));
}

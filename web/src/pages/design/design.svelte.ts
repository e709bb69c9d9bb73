/** State of the design page: parameters of the camera as text, changed fields, URL, quick estimate and full count. */
import { api } from '../../api/client';
import type { Design, DesignCameras, DesignQuestion, PerformanceSheet } from '../../api/types';
import { LatestRequest } from '../../lib/latestRequest';
import { short } from '../../lib/format';
import { problemText } from '../../lib/problems';
import { attempt, live } from '../../state/live.svelte';

export interface DesignField {
  key: string;
  label: string;
  unit: string;
  optional?: boolean;
}
export const GROUPS: readonly { name: string; fields: readonly DesignField[] }[] = [
  {
    name: 'Lens',
    fields: [
      { key: 'focal_mm', label: 'Focal length', unit: 'mm' },
      { key: 'f_number', label: 'f-number', unit: '' },
      { key: 'transmission', label: 'Transmission', unit: '' },
      { key: 'bandwidth_nm', label: 'Bandwidth', unit: 'nm' },
      { key: 'psf_sigma_px', label: 'Star image σ', unit: 'px' },
    ],
  },
  {
    name: 'Exposure and threshold',
    fields: [
      { key: 'exposure_s', label: 'Exposure', unit: 's' },
      { key: 'threshold_snr', label: 'Threshold SNR', unit: '' },
      { key: 'mag_limit', label: 'Limit V', unit: 'mag', optional: true },
    ],
  },
  {
    name: 'Detector',
    fields: [
      { key: 'columns', label: 'Columns', unit: 'px' },
      { key: 'rows', label: 'Rows', unit: 'px' },
      { key: 'pitch_col_um', label: 'Pitch, columns', unit: 'µm' },
      { key: 'pitch_row_um', label: 'Pitch, rows', unit: 'µm' },
      { key: 'efficiency', label: 'Efficiency', unit: 'e/ph' },
      { key: 'bits', label: 'Converter', unit: 'bit' },
      { key: 'gain_e_per_dn', label: 'Gain', unit: 'e/DN' },
      { key: 'bias_dn', label: 'Bias', unit: 'DN' },
      { key: 'full_well_e', label: 'Full well', unit: 'e' },
      { key: 'read_noise_e', label: 'Read noise', unit: 'e' },
      { key: 'dark_current_e_s', label: 'Dark current', unit: 'e/s' },
      { key: 'background_e_s', label: 'Background', unit: 'e/s' },
      { key: 'response_sigma', label: 'Response, σ', unit: '' },
    ],
  },
  {
    name: 'Baffle',
    fields: [
      { key: 'exclusion_deg', label: 'Excludes beyond', unit: '°' },
      { key: 'spare_mm', label: 'Spare width', unit: 'mm' },
    ],
  },
  { name: 'Full count', fields: [{ key: 'pointings', label: 'Pointings', unit: '' }] },
];
export const ORBIT: readonly DesignField[] = [
  { key: 'inclination_deg', label: 'Inclination', unit: '°' },
  { key: 'raan_from', label: 'Ω from', unit: '°' },
  { key: 'raan_to', label: 'Ω to', unit: '°' },
  { key: 'roll', label: 'Roll ±', unit: '°' },
  { key: 'pitch', label: 'Pitch ±', unit: '°' },
];
const MORE: Record<string, { min: number; max: number; base: number }> = {
  mag_limit: { min: -1.4, max: 12, base: NaN },
  exclusion_deg: { min: 1, max: 89, base: 40 },
  spare_mm: { min: 0, max: 1000, base: 0 },
  pointings: { min: 1000, max: 10_000_000, base: 1_000_000 },
  inclination_deg: { min: 0, max: 180, base: 97.6 },
  raan_from: { min: 0, max: 360, base: 0 },
  raan_to: { min: 0, max: 720, base: 360 },
  roll: { min: 0, max: 180, base: 5 },
  pitch: { min: 0, max: 180, base: 5 },
};
const WHOLE = ['columns', 'rows', 'bits', 'pointings'];
const WAIT_MS = 250;
export type Pointing = 'zenith' | 'nadir' | 'sunsat';

export class Desk {
  known = $state.raw<DesignCameras | null>(null);
  profile = $state('');
  /** Texts of the fields that differ from the profile. */
  edits = $state<Record<string, string>>({});
  sky = $state<'whole' | 'orbit'>('whole');
  pointing = $state<Pointing>('zenith');
  answer = $state.raw<Design | null>(null);
  sheet = $state.raw<PerformanceSheet | null>(null);
  problem = $state('');
  busy = $state(false);
  jobId = $state<number | null>(null);
  private readonly sheetRequest = new LatestRequest();
  private stop: AbortController | null = null;
  private timer: ReturnType<typeof setTimeout> | null = null;

  readonly base = $derived(this.known?.cameras.find((c) => c.name === this.profile) ?? null);
  readonly job = $derived(live.jobs.find((j) => j.id === this.jobId) ?? null);
  readonly changed = $derived(Object.keys(this.edits));

  baseOf(key: string): number {
    return this.base?.values[key] ?? MORE[key]?.base ?? NaN;
  }

  text(key: string): string {
    const b = this.baseOf(key);
    return this.edits[key] ?? (Number.isFinite(b) ? String(Number(b.toPrecision(6))) : '');
  }

  problemOf(f: DesignField): string {
    const text = this.text(f.key);
    if (f.optional && text.trim() === '') return '';
    const limit = this.known?.limits[f.key] ?? MORE[f.key];
    const v = numberOf(text);
    if (
      !limit ||
      (Number.isFinite(v) && v >= limit.min && v <= limit.max && (!WHOLE.includes(f.key) || Number.isInteger(v)))
    )
      return '';
    return `${short(limit.min)} – ${short(limit.max)}`;
  }

  get valid(): boolean {
    const fields = [...GROUPS.flatMap((g) => g.fields), ...(this.sky === 'orbit' ? ORBIT : [])];
    return this.base !== null && fields.every((f) => this.problemOf(f) === '');
  }

  set(key: string, text: string): void {
    const same =
      numberOf(text) === Number(this.baseOf(key).toPrecision(6)) ||
      (text.trim() === '' && !Number.isFinite(this.baseOf(key)));
    const others = Object.fromEntries(Object.entries(this.edits).filter(([k]) => k !== key));
    this.edits = same ? others : { ...others, [key]: text };
    this.later();
  }

  reset(key?: string): void {
    this.edits = key === undefined ? {} : Object.fromEntries(Object.entries(this.edits).filter(([k]) => k !== key));
    if (key === undefined) this.sky = 'whole';
    this.later();
  }

  choose(profile: string): void {
    this.profile = profile;
    this.edits = {};
    this.later();
  }

  get request(): DesignQuestion {
    const camera = Object.fromEntries(
      GROUPS.flatMap((g) => g.fields)
        .filter((f) => f.key in this.edits && this.text(f.key).trim() !== '')
        .map((f) => [f.key, numberOf(this.text(f.key))]),
    );
    const n = (key: string): number => numberOf(this.text(key));
    const orbit: Partial<DesignQuestion> =
      this.sky === 'orbit'
        ? {
            sky: 'orbit',
            pointing: this.pointing,
            inclination_deg: n('inclination_deg'),
            raan_deg: [n('raan_from'), n('raan_to')],
            roll_deg: [-n('roll'), n('roll')],
            pitch_deg: [-n('pitch'), n('pitch')],
            yaw_deg: this.pointing === 'sunsat' ? [130, 140] : [-5, 5],
          }
        : {};
    return { profile: this.profile, ...camera, ...orbit } as DesignQuestion;
  }

  /** Return the camera as a query string: the profile and the changed fields. */
  search(view: string): string {
    const q = new URLSearchParams({
      profile: this.profile,
      ...Object.fromEntries(Object.entries(this.edits).map(([k, v]) => [k, v.replace('\u2212', '-')])),
    });
    if (this.sky === 'orbit') {
      q.set('sky', 'orbit');
      q.set('pointing', this.pointing);
    }
    if (view) q.set('view', view);
    return `?${q.toString()}`;
  }

  fill(search: string): void {
    const q = new URLSearchParams(search);
    const names = this.known?.cameras.map((c) => c.name) ?? [];
    const profileName = q.get('profile') ?? '';
    this.profile = names.includes(profileName) ? profileName : (this.known?.unit ?? '');
    this.sky = q.get('sky') === 'orbit' ? 'orbit' : 'whole';
    const p = q.get('pointing');
    this.pointing = p === 'nadir' || p === 'sunsat' ? p : 'zenith';
    const fields = [...GROUPS.flatMap((g) => g.fields), ...ORBIT].map((f) => f.key);
    this.edits = Object.fromEntries(
      fields.flatMap((k) => {
        const v = q.get(k);
        return v === null ? [] : [[k, v.slice(0, 20)] as [string, string]];
      }),
    );
    this.problem =
      profileName && profileName !== this.profile
        ? `Unknown camera ${profileName.slice(0, 40)}. Showing ${this.profile} instead.`
        : '';
  }

  /** Request an estimate shortly after the last change. An older response never replaces a newer one. */
  later(wait = WAIT_MS): void {
    if (this.timer) clearTimeout(this.timer);
    this.stop?.abort();
    this.busy = false;
    if (!this.valid) return;
    this.timer = setTimeout(() => void this.loadEstimate(), wait);
  }

  private async loadEstimate(): Promise<void> {
    const stop = new AbortController();
    this.stop = stop;
    this.busy = true;
    try {
      this.answer = await api.design(this.request, stop.signal);
      this.problem = '';
    } catch (e) {
      if (stop.signal.aborted) return;
      this.problem = problemText(e);
    } finally {
      if (!stop.signal.aborted) this.busy = false;
    }
  }

  /** Request the performance sheet of the current camera. An older response never replaces a newer one. */
  async loadSheet(): Promise<void> {
    if (!this.valid || !this.answer) return;
    await this.sheetRequest.run(
      attempt(() => api.designSheet(this.request)),
      (v) => (this.sheet = v),
    );
  }

  async run(): Promise<void> {
    const request = JSON.stringify(this.request);
    const started = await attempt(() => api.runDesign(this.request));
    if (!started) return;
    live.put('job', started);
    this.jobId = started.id;
    this.runOf = request;
  }
  private runOf = '';

  /** Show the full count when its job is complete, unless the camera was changed in the meantime. */
  take(): void {
    const job = this.job;
    if (job?.state !== 'done') return;
    const design = job.result['design'] as Design | undefined;
    this.jobId = null;
    if (design && this.runOf === JSON.stringify(this.request)) this.answer = design;
  }
}

function numberOf(text: string): number {
  return text.trim() === '' ? NaN : Number(text.replace('\u2212', '-'));
}

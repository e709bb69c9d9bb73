/** State of the catalogue builder: the form as text, its checks, and the live preview. */
import { api } from '../../api/client';
import type { CatalogueDetail, CatalogueRequest, Heads, Preview, Profile, StarList } from '../../api/types';
import { short } from '../../lib/format';
import { problemText } from '../../lib/problems';
import { LIMITS, number, optional, OPTIONAL, START, wholeOr, type Texts } from './fields';

type Form = Required<CatalogueRequest>;
export type Law = Form['pointing'];
export type Corrections = Required<Form['corrections']>;
const WAIT_MS = 150;
const DEFAULT_CORRECTIONS: Corrections = {
  proper_motion: true,
  parallax: false,
  annual_aberration: false,
  orbital_aberration: false,
  frame: 'icrs',
  e_terms: true,
  instrument_magnitude: false,
  roll_off: 'off',
  doubles: '',
  doubles_separation_deg: null,
  flag_variables: false,
  variables_at_date: false,
};
const NOTHING: NonNullable<CatalogueRequest['occultation']> = {
  earth: false,
  earth_margin_deg: 0,
  sun: false,
  moon: false,
};
export type Screening = Required<NonNullable<Form['screening']>>;
export type MountedBy = 'law' | 'turns' | 'matrix' | 'heads';
const MARKS = { doubles: true, variables: true, fast: true };
const IDENTITY = '1 0 0\n0 1 0\n0 0 1';
export const ORBIT_LAWS: readonly Law[] = ['zenith', 'nadir', 'sunsat', 'target'];

export class Builder {
  /** Defaults of a new catalogue. */
  first = $state.raw<Texts>(START);
  readonly usual = DEFAULT_CORRECTIONS;
  texts = $state<Texts>({ ...START });
  corrections = $state<Corrections>({ ...DEFAULT_CORRECTIONS });
  name = $state('');
  /** If empty, the server uses the camera and the format of the configured instrument. */
  profile = $state('');
  format = $state('');
  orbit = $state<Form['orbit']>('none');
  tle = $state('');
  start = $state('');
  pointing = $state<Law>('zenith');
  method = $state<Form['method']>('exact');
  source = $state<Form['source']>('hipparcos');
  starList = $state<number | null>(null);
  lists = $state.raw<StarList[]>([]);
  earth = $state(false);
  sun = $state(false);
  moon = $state(false);
  dropVariables = $state(false);
  kVector = $state(false);
  /**
   * Attitude limits that are not symmetric about zero. They come from the command line or an older build and stay until
   * edited.
   */
  skewed = $state.raw<Partial<Record<'roll' | 'pitch' | 'yaw', [number, number]>>>({});
  /**
   * Mounting of the camera in the body: as defined by the pointing law, by three rotations (`turns`), by nine matrix
   * elements in rows, or the mountings of all heads of a spacecraft.
   */
  mountedBy = $state<MountedBy>('law');
  heads = $state.raw<Form['heads']>([]);
  matrix = $state(IDENTITY);
  screen = $state<Screening['action']>('off');
  marks = $state({ ...MARKS });
  thinning = $state<Form['thinning']>('circles');
  reduced = $state(false);
  /** True if the map shows similar triangles instead of the time in the field. */
  mistakes = $state(false);
  /** Camera and format of a new catalogue. */
  unit = $state.raw({ profile: '', format: '' });
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
    if (OPTIONAL.includes(key) && text.trim() === '') return '';
    const [a, b] = LIMITS[key];
    const v = number(text);
    return Number.isFinite(v) && v >= a && v <= b ? '' : `${short(a)} – ${short(b)}, got ${text || 'nothing'}`;
  }

  /** True if all fields are valid and the selected sources are complete. */
  get valid(): boolean {
    const listed = this.source !== 'list' || this.starList !== null;
    return (
      listed &&
      this.matrixProblem === '' &&
      this.mounted &&
      (Object.keys(LIMITS) as (keyof Texts)[]).every((k) => this.problemOf(k) === '') &&
      (this.orbit !== 'tle' || this.tle.trim() !== '')
    );
  }

  /** False if the mounting is that of a spacecraft's heads and no spacecraft is selected. */
  get mounted(): boolean {
    return this.mountedBy !== 'heads' || this.heads.length > 0;
  }

  get matrixElements(): number[] {
    return this.matrix
      .trim()
      .split(/[\s,;]+/)
      .map(number);
  }

  get matrixProblem(): string {
    if (this.mountedBy !== 'matrix') return '';
    const m = this.matrixElements;
    return m.length === 9 && m.every(Number.isFinite)
      ? ''
      : `nine numbers by rows, got ${m.filter(Number.isFinite).length}`;
  }

  get rotatesWithOrbit(): boolean {
    return ORBIT_LAWS.includes(this.pointing);
  }

  get request(): CatalogueRequest {
    const t = this.texts;
    const symmetric = (key: 'roll' | 'pitch' | 'yaw'): [number, number] =>
      this.skewed[key] ?? [-number(t[key]), number(t[key])];
    return {
      name: this.name,
      profile: this.profile,
      format: this.format,
      orbit: this.orbit,
      inclination_deg: number(t.inclination_deg),
      raan_deg: [number(t.raan_from), number(t.raan_to)],
      altitude_km: this.orbit === 'tle' ? null : optional(t.altitude_km),
      eccentricity: this.orbit === 'elements' ? number(t.eccentricity) : 0,
      perigee_deg: this.orbit === 'elements' ? number(t.perigee_deg) : 0,
      tle: this.tle,
      start: this.start,
      days: number(t.days),
      pointing: this.pointing,
      roll_deg: symmetric('roll'),
      pitch_deg: symmetric('pitch'),
      yaw_deg: symmetric('yaw'),
      ra_deg: number(t.ra_deg),
      dec_deg: number(t.dec_deg),
      field_roll_deg: number(t.field_roll_deg),
      off_nadir_deg: number(t.off_nadir_deg),
      body_from_cam: this.mountedBy === 'matrix' ? this.matrixElements : null,
      mounting_deg: this.mountedBy === 'turns' ? [number(t.turn_x), number(t.turn_y), number(t.turn_z)] : null,
      heads: this.mountedBy === 'heads' ? this.heads : [],
      margin_deg: number(t.margin_deg),
      method: this.method,
      source: this.source,
      star_list: this.source === 'list' ? this.starList : null,
      corrections: { ...this.corrections },
      occultation: {
        earth: this.earth,
        earth_margin_deg: number(t.earth_margin_deg),
        sun: this.sun,
        sun_deg: optional(t.sun_deg),
        moon: this.moon,
        moon_deg: optional(t.moon_deg),
      },
      epoch_jyear: optional(t.epoch_jyear),
      faint_mag: number(t.faint_mag),
      bright_mag: number(t.bright_mag),
      min_separation_deg: number(t.min_separation_deg),
      brightest_per_field: Math.round(number(t.brightest_per_field)),
      drop_variables: this.dropVariables,
      pair_min_deg: number(t.pair_min_deg),
      pair_max_deg: optional(t.pair_max_deg),
      bank_bytes: null,
      k_vector: this.kVector,
      thinning: this.thinning,
      screening: {
        action: this.screen,
        ...this.marks,
        most_companions: wholeOr(t.companions),
        most_false: optional(t.false_triples),
        arc_deg: number(t.ring_arc),
        tolerance_deg: number(t.ring_tolerance),
      },
      reduced: this.reduced
        ? {
            width_deg: number(t.reduced_width),
            height_deg: number(t.reduced_height),
            brightest: Math.round(number(t.reduced_brightest)),
            step_deg: number(t.reduced_step),
          }
        : null,
    };
  }

  /** Select a camera and its magnitude limit. Also selects its format if it does not support the present one. */
  pick(camera: Profile): void {
    this.profile = camera.name;
    this.texts.faint_mag = String(camera.faint_mag);
    if (!camera.formats.includes(this.format)) this.format = camera.formats[0] ?? this.format;
  }

  /**
   * Start with the camera of the configured instrument, unless a camera is selected. A magnitude limit entered before
   * stays.
   */
  startWith(cameras: readonly Profile[]): void {
    const own = cameras.find((camera) => camera.unit);
    if (!own) return;
    const typed = this.texts.faint_mag;
    const edited = typed !== this.first.faint_mag;
    this.unit = { profile: own.name, format: own.formats[0] ?? '' };
    this.first = { ...START, faint_mag: String(own.faint_mag) };
    if (this.profile === '') this.pick(own);
    if (edited) this.texts.faint_mag = typed;
  }

  /** Fill the form with the request of an existing catalogue. */
  fill(detail: Pick<CatalogueDetail, 'name' | 'profile' | 'format' | 'request'>): void {
    const r = detail.request as Partial<Form>;
    const o: NonNullable<CatalogueRequest['occultation']> = r.occultation ?? NOTHING;
    const text = (v: unknown, old: string): string => (v === undefined || v === null ? old : String(v));
    this.name = detail.name;
    this.profile = detail.profile;
    this.format = detail.format;
    this.orbit = r.orbit ?? 'none';
    this.tle = r.tle ?? '';
    this.start = r.start ?? '';
    this.pointing = r.pointing ?? 'zenith';
    this.method = r.method ?? 'exact';
    this.source = r.source ?? 'hipparcos';
    this.starList = r.star_list ?? null;
    this.heads = r.heads ?? [];
    this.mountedBy = this.heads.length ? 'heads' : r.body_from_cam ? 'matrix' : r.mounting_deg ? 'turns' : 'law';
    this.matrix = r.body_from_cam
      ? [0, 3, 6].map((i) => r.body_from_cam?.slice(i, i + 3).join(' ')).join('\n')
      : IDENTITY;
    const s = r.screening;
    this.screen = s?.action ?? 'off';
    this.marks = { doubles: s?.doubles ?? true, variables: s?.variables ?? true, fast: s?.fast ?? true };
    this.thinning = r.thinning ?? 'circles';
    this.reduced = Boolean(r.reduced);
    this.dropVariables = r.drop_variables ?? false;
    this.kVector = r.k_vector ?? false;
    [this.earth, this.sun, this.moon] = [o.earth ?? false, o.sun ?? false, o.moon ?? false];
    this.corrections = { ...DEFAULT_CORRECTIONS, ...r.corrections };
    this.skewed = Object.fromEntries(
      (['roll', 'pitch', 'yaw'] as const).flatMap((k) => {
        const range = r[`${k}_deg`];
        return range && range[0] !== undefined && range[1] !== undefined && range[0] !== -range[1]
          ? [[k, [range[0], range[1]]]]
          : [];
      }),
    );
    const plain = Object.fromEntries(
      (Object.keys(START) as (keyof Texts)[]).map((k) => [k, text((r as Record<string, unknown>)[k], START[k])]),
    ) as unknown as Texts;
    this.texts = {
      ...plain,
      raan_from: text(r.raan_deg?.[0], START.raan_from),
      raan_to: text(r.raan_deg?.[1], START.raan_to),
      roll: text(r.roll_deg?.[1], START.roll),
      pitch: text(r.pitch_deg?.[1], START.pitch),
      yaw: text(r.yaw_deg?.[1], START.yaw),
      earth_margin_deg: text(o.earth_margin_deg, START.earth_margin_deg),
      sun_deg: text(o.sun_deg, ''),
      moon_deg: text(o.moon_deg, ''),
      companions: text(s?.most_companions, ''),
      false_triples: text(s?.most_false, ''),
      ring_arc: text(s?.arc_deg, START.ring_arc),
      ring_tolerance: text(s?.tolerance_deg, START.ring_tolerance),
      reduced_width: text(r.reduced?.width_deg, START.reduced_width),
      reduced_height: text(r.reduced?.height_deg, START.reduced_height),
      reduced_brightest: text(r.reduced?.brightest, START.reduced_brightest),
      reduced_step: text(r.reduced?.step_deg, START.reduced_step),
      turn_x: text(r.mounting_deg?.[0], START.turn_x),
      turn_y: text(r.mounting_deg?.[1], START.turn_y),
      turn_z: text(r.mounting_deg?.[2], START.turn_z),
    };
    this.preview = null;
    this.problem = '';
  }

  /** Fill the form with the defaults of a new catalogue for the unit's camera. */
  reset(): void {
    this.fill({ name: '', ...this.unit, request: { faint_mag: this.first.faint_mag } });
  }

  /** Use the present mountings of all heads of a spacecraft. */
  mount(spacecraft: Heads): void {
    this.heads = spacecraft.heads.map((h) => ({ unit: h.unit, body_from_cam: null, mounting_deg: h.mounting_deg }));
  }

  /** Set the limit of an angle. The limit is then symmetric. */
  setLimit(key: 'roll' | 'pitch' | 'yaw', value: string): void {
    this.texts[key] = value;
    this.skewed = { ...this.skewed, [key]: undefined };
  }

  /** Request a preview shortly after the last change. An older response never replaces a newer one. */
  changed(): void {
    if (this.timer) clearTimeout(this.timer);
    this.stop?.abort();
    this.busy = false;
    if (!this.valid) return;
    this.timer = setTimeout(() => void this.loadPreview(), WAIT_MS);
  }

  private async loadPreview(): Promise<void> {
    const stop = new AbortController();
    this.stop = stop;
    this.busy = true;
    try {
      this.preview = await api.preview(this.request, this.mistakes, stop.signal);
      this.problem = '';
    } catch (e) {
      if (stop.signal.aborted) return;
      this.problem = problemText(e);
    } finally {
      if (!stop.signal.aborted) this.busy = false;
    }
  }
}

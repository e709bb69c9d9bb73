/** Texts, drawings and requests for spacecraft with several heads. Rotations are about the body axes. */
import type { Head, HeadPair, Heads, SpacecraftRequest } from '../../api/types';
import { degrees, fixed, span } from '../../lib/format';
import type { Cell } from './fleet';

export type Vector = readonly [number, number, number];
export const AXES = ['x', 'y', 'z'] as const;

/** Return the state of a head: whether its attitude is used, or why it is not. */
export function headOf(h: Head): Cell {
  if (!h.served) return { state: 'unknown', word: h.problem };
  const age = h.age_s === null ? 'nothing received' : `${span(h.age_s)} old`;
  if (!h.fresh) return { state: 'unknown', word: `silent, ${age}` };
  return h.problem ? { state: 'watch', word: `not used: ${h.problem}` } : { state: 'ok', word: age };
}

/** Format angles: "3.1″ 3.2″ 8.0″". */
export function arcsecs(values: readonly number[], decimals = 1): string {
  return values.map((v) => `${fixed(v, decimals)}″`).join(' ');
}

/** Format right ascension, declination and roll of the body. */
export function pointing(a: { ra_deg: number; dec_deg: number; roll_deg: number }): string {
  return `${degrees(a.ra_deg)} ${degrees(a.dec_deg, 4, true)} ${degrees(a.roll_deg)}`;
}

/** Format the value of each axis: "+60.2 ± 2.5″". */
export function measured(values: readonly number[], sigmas: readonly number[], unit: string): string[] {
  return values.map((v, i) => `${fixed(v, 1, true)} ± ${fixed(sigmas[i], 1)}${unit}`);
}

/**
 * Project a body direction to the drawing: x to the lower left, y to the right, z up. Lengths along y and z are true.
 */
export function project([x, y, z]: Vector, size: number): [number, number] {
  return [size * (y - 0.5 * x), size * (0.36 * x - z)];
}

export interface BandLine {
  label: string;
  x: number[];
  y: number[];
  /** Standard deviations: the band is y ± s. */
  s: number[];
}

/** Return the history of a head as lines with bands. */
export function lines(points: readonly HeadPair[]): {
  angle: BandLine[];
  chi2: BandLine[];
  misalignment: BandLine[];
  drift: BandLine[];
} {
  const x = points.map((p) => Date.parse(p.at) / 1000);
  const zeros = points.map(() => 0);
  const line = (label: string, y: number[], s: number[]): BandLine => ({ label, x, y, s });
  const axes = (values: (p: HeadPair) => readonly number[], sigmas: (p: HeadPair) => readonly number[]): BandLine[] =>
    AXES.map((axis, i) =>
      line(
        axis,
        points.map((p) => values(p)[i] ?? 0),
        points.map((p) => sigmas(p)[i] ?? 0),
      ),
    );
  return {
    angle: [
      line(
        'between the attitudes',
        points.map((p) => p.angle_arcsec),
        points.map((p) => p.angle_sigma_arcsec),
      ),
      line(
        'between the boresights, minus nominal',
        points.map((p) => p.boresight_arcsec),
        points.map((p) => p.boresight_sigma_arcsec),
      ),
    ],
    chi2: [
      line(
        'χ²',
        points.map((p) => p.chi2),
        zeros,
      ),
    ],
    misalignment: axes(
      (p) => p.misalignment_arcsec,
      (p) => p.misalignment_sigma_arcsec,
    ),
    drift: axes(
      (p) => p.drift_arcsec_h,
      (p) => p.drift_sigma_arcsec_h,
    ),
  };
}

/** Texts of a head in the form. */
export interface HeadDraft {
  unit: string;
  x: string;
  y: string;
  z: string;
  sigma: string;
  cross: string;
  roll: string;
}

const text = (v: number | null): string => (v === null ? '' : String(Number(v.toPrecision(10))));

export function draftOf(h: Head): HeadDraft {
  const [x, y, z] = h.mounting_deg;
  return {
    unit: h.unit,
    x: text(x),
    y: text(y),
    z: text(z),
    sigma: text(h.sigma_arcsec),
    cross: text(h.sigma_cross_arcsec),
    roll: text(h.sigma_roll_arcsec),
  };
}

export const newDraft = (unit: string): HeadDraft => ({
  unit,
  x: '0',
  y: '0',
  z: '0',
  sigma: '0',
  cross: '',
  roll: '',
});

/** Parse a field: null if it is empty, NaN if it is not a number. */
export function numberOf(field: string): number | null {
  const text = field.trim().replace('−', '-').replace(',', '.');
  return text === '' ? null : Number(text);
}

export interface Draft {
  name: string;
  source: Heads['source'];
  tolerance: string;
  stale: string;
  rate: string;
  misalignment: string;
  drift: string;
  heads: HeadDraft[];
}

export const draft = (s: Heads | null, units: readonly string[]): Draft => ({
  name: s?.name ?? '',
  source: s?.source ?? 'on board',
  tolerance: text(s?.tolerance_s ?? 1),
  stale: text(s?.stale_s ?? 30),
  rate: text(s?.largest_rate_deg_s ?? null),
  misalignment: text(s?.misalignment_limit_arcsec ?? null),
  drift: text(s?.drift_limit_arcsec_h ?? null),
  heads: s ? s.heads.map(draftOf) : units.slice(0, 2).map(newDraft),
});

/** Return the request of a form, or a message about its first problem. */
export function requestOf(d: Draft): SpacecraftRequest | string {
  const notANumber = (name: string): string => `${name} is not a number.`;
  const required = (v: string): number | null => {
    const n = numberOf(v);
    return n === null || Number.isNaN(n) ? null : n;
  };
  if (!d.name.trim()) return 'Enter a name.';
  if (!d.heads.length) return 'Add a head.';
  const heads: SpacecraftRequest['heads'] = [];
  for (const h of d.heads) {
    const [x, y, z, sigma] = [h.x, h.y, h.z, h.sigma].map(required);
    if (x == null || y == null || z == null || sigma == null) return notANumber(`The mounting of ${h.unit}`);
    const [cross, roll] = [numberOf(h.cross), numberOf(h.roll)];
    if (Number.isNaN(cross) || Number.isNaN(roll)) return notANumber(`The attitude σ of ${h.unit}`);
    heads.push({
      unit: h.unit,
      mounting_deg: [x, y, z],
      sigma_arcsec: sigma,
      sigma_cross_arcsec: cross,
      sigma_roll_arcsec: roll,
    });
  }
  const [tolerance, stale] = [required(d.tolerance), required(d.stale)];
  if (tolerance === null) return notANumber('The tolerance');
  if (stale === null) return notANumber('The time after which a head is silent');
  const optional = [
    ['The largest rate', d.rate],
    ['The limit of misalignment', d.misalignment],
    ['The limit of drift', d.drift],
  ].map(([what, v]) => [what, numberOf(v ?? '')] as const);
  const bad = optional.find(([, v]) => Number.isNaN(v));
  if (bad) return notANumber(bad[0] ?? '');
  const [rate, misalignment, drift] = optional.map(([, v]) => v);
  return {
    name: d.name.trim(),
    heads,
    source: d.source,
    tolerance_s: tolerance,
    stale_s: stale,
    largest_rate_deg_s: rate ?? null,
    misalignment_limit_arcsec: misalignment ?? null,
    drift_limit_arcsec_h: drift ?? null,
  };
}

/** Texts and geometry of passes. Angles are in degrees, times in ISO 8601. */
import type { Pass, Plan, StationIn, TrackPoint } from '../../api/types';
import type { LampState } from '../../lib/lamp';

export interface MaskPoint {
  azimuth_deg: number;
  elevation_deg: number;
}

const POINTS = ['N', 'NE', 'E', 'SE', 'S', 'SW', 'W', 'NW'];

/** Format an azimuth, measured from north towards east: "NE 47°". */
export function compass(azimuth: number): string {
  const turn = ((azimuth % 360) + 360) % 360;
  return `${POINTS[Math.round(turn / 45) % 8] ?? 'N'} ${Math.round(turn) % 360}°`;
}

/**
 * Return the position in a sky plot with the centre 0, 0: zenith in the centre, north up, east to the right as on a
 * map.
 */
export function inSky(azimuth: number, elevation: number, radius: number): [number, number] {
  const r = (radius * (90 - Math.max(0, elevation))) / 90;
  const a = (azimuth * Math.PI) / 180;
  return [r * Math.sin(a), -r * Math.cos(a)];
}

/** Return the track as SVG paths. A new path starts where the spacecraft enters or leaves the Earth's shadow. */
export function tracks(points: readonly TrackPoint[], radius: number): { path: string; sunlit: boolean }[] {
  const out: { path: string; sunlit: boolean }[] = [];
  points.forEach((p, i) => {
    const [x, y] = inSky(p.azimuth_deg, p.elevation_deg, radius);
    const point = `${x.toFixed(1)} ${y.toFixed(1)}`;
    const last = out.at(-1);
    if (last) last.path += `L${point}`;
    if (!last || last.sunlit !== p.sunlit) {
      if (i === points.length - 1) return;
      out.push({ path: `M${point}`, sunlit: p.sunlit });
    }
  });
  return out;
}

/** Return the pass in progress, otherwise the next pass; null if there is none. */
export function nextPass(passes: readonly Pass[], nowMs: number): Pass | null {
  return passes.find((p) => Date.parse(p.set) > nowMs) ?? null;
}

export const underWay = (p: Pass, nowMs: number): boolean => Date.parse(p.rise) <= nowMs && nowMs < Date.parse(p.set);

/** Format the time to the rise, "in 1 h 02 min 03 s", or during a pass the time to the set, "sets in 2 min 04 s". */
export function countdown(p: Pass, nowMs: number): string {
  if (Date.parse(p.set) <= nowMs) return 'over';
  const under = underWay(p, nowMs);
  return `${under ? 'sets ' : ''}in ${lasting((Date.parse(under ? p.set : p.rise) - nowMs) / 1000)}`;
}

export function lasting(seconds: number): string {
  const s = Math.max(0, Math.floor(seconds));
  const two = (n: number): string => String(n).padStart(2, '0');
  const [h, m] = [Math.floor(s / 3600), Math.floor(s / 60) % 60];
  if (h >= 48) return `${Math.floor(h / 24)} d ${h % 24} h`;
  return h ? `${h} h ${two(m)} min ${two(s % 60)} s` : m ? `${m} min ${two(s % 60)} s` : `${s} s`;
}

/** Parse lines "azimuth, elevation" to points in order of azimuth. Returns a message if a line is invalid. */
export function readMask(text: string): MaskPoint[] | string {
  const points: MaskPoint[] = [];
  for (const [i, line] of text.split('\n').entries()) {
    const words = line.trim();
    if (!words || words.startsWith('#')) continue;
    const parts = words.split(/[\s,;]+/).map(Number);
    const [azimuth, elevation] = parts;
    if (parts.length !== 2 || azimuth === undefined || elevation === undefined || !parts.every(Number.isFinite))
      return `Line ${i + 1} is not "azimuth, elevation" in degrees.`;
    if (azimuth < 0 || azimuth >= 360 || elevation < -10 || elevation > 89)
      return `Line ${i + 1} is out of range: azimuth 0 to 360, elevation −10 to 89.`;
    points.push({ azimuth_deg: azimuth, elevation_deg: elevation });
  }
  return points.sort((a, b) => a.azimuth_deg - b.azimuth_deg);
}

export const maskText = (points: readonly MaskPoint[]): string =>
  points.map((p) => `${p.azimuth_deg}, ${p.elevation_deg}`).join('\n');

export const NEW_STATION: StationIn = {
  name: '',
  latitude_deg: 0,
  longitude_deg: 0,
  height_m: 0,
  min_elevation_deg: 5,
  mask: [],
  line_url: '',
  line_baud: 0,
  note: '',
};

export const isActive = (state: Plan['state']): boolean => ['armed', 'running', 'paused', 'waiting'].includes(state);

export function planLamp(state: Plan['state']): LampState {
  if (state === 'completed') return 'ok';
  if (state === 'failed') return 'critical';
  if (state === 'stopped' || state === 'missed') return 'warning';
  if (state === 'paused') return 'watch';
  return state === 'draft' ? 'never' : 'progress';
}

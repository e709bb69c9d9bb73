/** Words and geometry of passes. Angles in degrees, times ISO 8601. */
import type { Pass, Plan, StationIn, TrackPoint } from '../../api/types';
import type { LampState } from '../../lib/lamp';

export interface MaskPoint {
  azimuth_deg: number;
  elevation_deg: number;
}

const POINTS = ['N', 'NE', 'E', 'SE', 'S', 'SW', 'W', 'NW'];

/** "NE 47°" of an azimuth from north by east. */
export function compass(azimuth: number): string {
  const turn = ((azimuth % 360) + 360) % 360;
  return `${POINTS[Math.round(turn / 45) % 8] ?? 'N'} ${Math.round(turn) % 360}°`;
}

/** Position in a sky plot of this radius about 0, 0: zenith in the middle, north up, east to the right as on a map. */
export function inSky(azimuth: number, elevation: number, radius: number): [number, number] {
  const r = (radius * (90 - Math.max(0, elevation))) / 90;
  const a = (azimuth * Math.PI) / 180;
  return [r * Math.sin(a), -r * Math.cos(a)];
}

/** The track as SVG paths, a new one where the spacecraft enters or leaves the Earth's shadow. */
export function tracks(points: readonly TrackPoint[], radius: number): { path: string; sunlit: boolean }[] {
  const out: { path: string; sunlit: boolean }[] = [];
  points.forEach((p, i) => {
    const [x, y] = inSky(p.azimuth_deg, p.elevation_deg, radius);
    const word = `${x.toFixed(1)} ${y.toFixed(1)}`;
    const last = out.at(-1);
    if (last) last.path += `L${word}`;
    if (!last || last.sunlit !== p.sunlit) {
      if (i === points.length - 1) return;
      out.push({ path: `M${word}`, sunlit: p.sunlit });
    }
  });
  return out;
}

/** The pass under way, else the next one. */
export function nextPass(passes: readonly Pass[], nowMs: number): Pass | null {
  return passes.find((p) => Date.parse(p.set) > nowMs) ?? null;
}

export const underWay = (p: Pass, nowMs: number): boolean => Date.parse(p.rise) <= nowMs && nowMs < Date.parse(p.set);

/** "in 1 h 02 min 03 s" to a rise, "sets in 2 min 04 s" during a pass. */
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

/** Lines "azimuth, elevation" as points in order of azimuth; a string says which line is wrong. */
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

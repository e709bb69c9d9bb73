import { describe, expect, it } from 'vitest';
import type { Pass, TrackPoint } from '../../api/types';
import { compass, countdown, inSky, lasting, maskText, nextPass, readMask, tracks } from './passes';

const pass = (rise: string, set: string): Pass => ({ rise, set }) as Pass;
const A = pass('2026-12-01T10:00:00.000Z', '2026-12-01T10:08:00.000Z');
const B = pass('2026-12-01T11:40:00.000Z', '2026-12-01T11:50:00.000Z');
const at = (clock: string): number => Date.parse(`2026-12-01T${clock}.000Z`);

describe('passes', () => {
  it('the next pass is the one under way, else the next to rise', () => {
    expect(nextPass([A, B], at('09:00:00'))).toBe(A);
    expect(nextPass([A, B], at('10:07:59'))).toBe(A);
    expect(nextPass([A, B], at('10:08:00'))).toBe(B);
    expect(nextPass([A, B], at('12:00:00'))).toBeNull();
  });
  it('counts down to the rise, then to the set', () => {
    expect(countdown(A, at('08:58:57'))).toBe('in 1 h 01 min 03 s');
    expect(countdown(A, at('10:05:56'))).toBe('sets in 2 min 04 s');
    expect(countdown(A, at('10:08:00'))).toBe('over');
    expect(lasting(3 * 86400 + 7200)).toBe('3 d 2 h');
  });
  it('names directions by the nearest of eight points', () => {
    expect([compass(0), compass(22), compass(47), compass(359.6), compass(-90)]).toEqual([
      'N 0°',
      'N 22°',
      'NE 47°',
      'N 0°',
      'W 270°',
    ]);
  });
  it('draws north up, east right and the zenith in the middle', () => {
    expect(inSky(0, 0, 90)).toEqual([0, -90]);
    const [x, y] = inSky(90, 30, 90);
    expect([x, Math.abs(y) < 1e-9]).toEqual([60, true]);
    expect(inSky(200, 90, 90).every((v) => Math.abs(v) < 1e-9)).toBe(true);
  });
  it('cuts the track at the shadow without a hole', () => {
    const point = (azimuth_deg: number, sunlit: boolean): TrackPoint =>
      ({ azimuth_deg, elevation_deg: 45, sunlit, at: '', range_km: 1 }) as TrackPoint;
    const cut = tracks([point(0, true), point(10, true), point(20, false), point(30, false)], 100);
    expect(cut.map((t) => t.sunlit)).toEqual([true, false]);
    expect(cut[0]?.path.split('L').at(-1)).toBe(cut[1]?.path.slice(1).split('L')[0]);
  });
  it('reads a mask in any order and names a wrong line', () => {
    expect(readMask('90, 12\n# hill\n\n0 4')).toEqual([
      { azimuth_deg: 0, elevation_deg: 4 },
      { azimuth_deg: 90, elevation_deg: 12 },
    ]);
    expect(readMask('90')).toBe('Line 1 is not "azimuth, elevation" in degrees.');
    expect(readMask('0 1\n400 2')).toContain('Line 2 is out of range');
    expect(readMask(maskText([{ azimuth_deg: 5, elevation_deg: 1 }]))).toEqual([{ azimuth_deg: 5, elevation_deg: 1 }]);
  });
});

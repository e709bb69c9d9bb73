import { describe, expect, it } from 'vitest';
import type { Star } from '../../api/types';
import { starRows, tabOf } from './starTabs';

const star = (index: number, hip: number | null, dx_arcsec: number | null = null): Star =>
  ({ index, hip, dx_arcsec, dy_arcsec: dx_arcsec === null ? null : 0 }) as Star;
const region = (rejected: string) => ({ rejected, col_min: 0, col_max: 1, row_min: 0, row_max: 1 });
const run = (stars: Star[]): Parameters<typeof starRows>[0] =>
  ({ stars, regions: [region('too small'), region('')], predicted: [] }) as unknown as Parameters<typeof starRows>[0];

describe('tabs of the star table', () => {
  it('list a detection without a match in its own tab, not under Matched', () => {
    const rows = starRows(run([star(0, null), star(1, null)]));
    expect(rows.matched).toEqual([]);
    expect(rows.unmatched.map((x) => x.index)).toEqual([0, 1]);
    expect(rows.rejected.map((r) => r.rejected)).toEqual(['too small']);
  });
  it('list matched stars by residual, and every star once', () => {
    const rows = starRows(run([star(0, 11, 2), star(1, null), star(2, 12, -9)]));
    expect(rows.matched.map((x) => x.index)).toEqual([2, 0]);
    expect(rows.unmatched.map((x) => x.index)).toEqual([1]);
  });
  it('lead from a star that was selected in the image to its tab', () => {
    const rows = starRows(run([star(0, 11), star(1, null)]));
    expect([0, 1, 7, null].map((index) => tabOf(rows, index))).toEqual(['matched', 'unmatched', null, null]);
  });
  it('are empty without a run', () => {
    expect(starRows(null)).toEqual({ matched: [], unmatched: [], rejected: [], predicted: [] });
  });
});

import { describe, expect, it } from 'vitest';
import type { Difference } from '../../api/types';
import { bars, MOST, summary, withNewest } from './differences';

const comparison = (cross: number): Omit<Difference, 'frame_id' | 'taken'> => ({
  d_ra_arcsec: 0,
  d_dec_arcsec: 0,
  d_roll_arcsec: 0,
  cross_arcsec: cross,
  agree: cross < 30,
  text: '',
});
const row = (id: number, cross: number): Difference => ({
  ...comparison(cross),
  frame_id: id,
  taken: '2026-12-01T18:42:07Z',
});

describe('differences over time', () => {
  it('take a new frame at the end, replace one that was solved again, and keep the newest', () => {
    const rows = Array.from({ length: MOST }, (_, i) => row(i + 1, 2));
    const more = withNewest(rows, MOST + 1, '2026-12-01T18:43:07Z', comparison(9));
    expect([more.length, more[0]?.frame_id, more.at(-1)?.cross_arcsec]).toEqual([MOST, 2, 9]);
    expect(withNewest(rows, 5, '', comparison(4)).find((r) => r.frame_id === 5)?.cross_arcsec).toBe(4);
    expect(withNewest(rows, 5, '', comparison(2))).toBe(rows);
  });
  it('are drawn to scale, and marked where sensor and ground disagree', () => {
    const [small, large] = bars([row(1, 10), row(2, 40)], 100, 22);
    expect(small?.height).toBe(5);
    expect(large).toMatchObject({ y: 2, height: 20, agree: false });
  });
  it('are summarized', () => {
    expect(summary([row(1, 1), row(2, 6.4), row(3, 2)])).toBe('median 2.0″, maximum 6.4″, 3 frames');
  });
});

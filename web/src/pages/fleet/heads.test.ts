import { describe, expect, it } from 'vitest';
import type { Head, HeadPair } from '../../api/types';
import { draft, headOf, lines, measured, newDraft, project, requestOf } from './heads';

const head: Head = {
  unit: 'A',
  mounting_deg: [80, 0, 10],
  body_from_cam: [0, 0, 0, 1],
  boresight: [0, -1, 0],
  sigma_arcsec: 5,
  sigma_cross_arcsec: null,
  sigma_roll_arcsec: null,
  served: true,
  fresh: true,
  age_s: 1.2,
  problem: '',
  attitude: null,
};

describe('heads of a spacecraft', () => {
  it('says whether the attitude of a head is used', () => {
    expect(headOf(head)).toEqual({ state: 'ok', word: '1.2 s old' });
    expect(headOf({ ...head, problem: 'no σ' })).toEqual({ state: 'watch', word: 'not used: no σ' });
    expect(headOf({ ...head, fresh: false, age_s: null })).toEqual({
      state: 'unknown',
      word: 'silent, nothing received',
    });
    expect(headOf({ ...head, served: false, problem: 'this server has no such unit' }).state).toBe('unknown');
  });
  it('writes values with their uncertainty', () => {
    expect(measured([60.2, -3], [2.52, 1], '″')).toEqual(['+60.2 ± 2.5″', '−3.0 ± 1.0″']);
  });
  it('draws z up and y to the right', () => {
    expect(project([0, 0, 1], 10)).toEqual([0, -10]);
    expect(project([0, 1, 0], 10)).toEqual([10, 0]);
  });
  it('makes lines with bands of the history', () => {
    const point = {
      unit: 'B',
      at: '2026-11-25T12:00:00.000Z',
      angle_arcsec: 61,
      angle_sigma_arcsec: 3,
      chi2: 30,
      misalignment_arcsec: [60, 1, 2],
      misalignment_sigma_arcsec: [3, 4, 5],
      drift_arcsec_h: [1, 2, 3],
      drift_sigma_arcsec_h: [9, 8, 7],
    } as unknown as HeadPair;
    const { misalignment, drift, angle } = lines([point]);
    expect(misalignment.map((l) => [l.y[0], l.s[0]])).toEqual([
      [60, 3],
      [1, 4],
      [2, 5],
    ]);
    expect(drift[2]).toEqual({ label: 'z', x: [Date.parse(point.at) / 1000], y: [3], s: [7] });
    expect(angle[0]?.y).toEqual([61]);
  });
  it('makes a request of the form, or names the first mistake', () => {
    const d = { ...draft(null, ['A', 'B', 'C']), name: ' SAT ' };
    expect(d.heads.map((h) => h.unit)).toEqual(['A', 'B']);
    d.heads[1] = { ...newDraft('B'), x: '−80,5', sigma: '10' };
    const made = requestOf(d);
    expect(made).toMatchObject({ name: 'SAT', largest_rate_deg_s: null });
    expect(typeof made !== 'string' && made.heads[1]?.mounting_deg).toEqual([-80.5, 0, 0]);
    expect(requestOf({ ...d, name: '' })).toBe('Enter a name.');
    expect(requestOf({ ...d, heads: [] })).toBe('Add a head.');
    expect(requestOf({ ...d, heads: [{ ...newDraft('B'), y: 'up' }] })).toBe('The mounting of B is not a number.');
    expect(requestOf({ ...d, drift: 'fast' })).toBe('The limit of drift is not a number.');
    expect(requestOf({ ...d, stale: '' })).toBe('The time after which a head is silent is not a number.');
  });
});

import { describe, expect, it } from 'vitest';
import { scale, ticks } from './plot';

describe('scales', () => {
  it('puts the ends at 0 and 1, linear and logarithmic', () => {
    for (const log of [false, true]) {
      const s = scale(2, 200, log);
      expect(s.place(2)).toBeCloseTo(0);
      expect(s.place(200)).toBeCloseTo(1);
      expect(s.place(log ? 20 : 101)).toBeCloseTo(0.5);
    }
  });
  it('labels only round values between the ends', () => {
    expect(ticks(scale(0.3, 4.1), 4)).toEqual([1, 2, 3, 4]);
    expect(ticks(scale(0.01, 10, true), 4)).toEqual([0.01, 0.1, 1, 10]);
    expect(ticks(scale(0.02, 2, true), 8)).toEqual([0.02, 0.05, 0.1, 0.2, 0.5, 1, 2]);
  });
  it('gives a constant line a range and a finite list of labels', () => {
    expect(scale(5, 5).place(5)).toBeCloseTo(0.5);
    expect(ticks(scale(1, 1e9, true), 3).length).toBeLessThanOrEqual(5);
  });
});

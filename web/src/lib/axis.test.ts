import { describe, expect, it } from 'vitest';
import { clockAt, intervalAxis, labelMiddle, timeTicks, tickLabel } from './axis';

describe('axes', () => {
  it('puts ticks at round times inside the span', () => {
    expect(timeTicks(0, 300)).toEqual([0, 60, 120, 180, 240, 300]);
  });
  it('has a few dates on the axis of a year', () => {
    const year = timeTicks(1_767_225_600, 1_798_761_600);
    expect(year.length).toBeLessThanOrEqual(7);
    expect(clockAt(1_767_225_600, 31_536_000)).toBe('2026-01-01');
  });
  it('ends the axis of intervals at the largest bound, and at 1 if all values are 0', () => {
    const zero = { value: 0, low: 0, high: 0 };
    expect(intervalAxis([zero], false)).toEqual([0, 1]);
    expect(intervalAxis([zero, { value: 2, low: 1, high: null }], false)).toEqual([0, 2.1]);
    expect(intervalAxis([{ value: 3, low: 1, high: 100 }], true)).toEqual([1, 105]);
  });
  it('has fewer times where there is less room, and no label beyond the edge', () => {
    expect(timeTicks(0, 86400).length).toBeGreaterThan(timeTicks(0, 86400, 250).length);
    expect(labelMiddle(380, '11-27 18:00', 390)).toBeLessThan(360);
    expect(labelMiddle(100, '11-27 18:00', 390)).toBe(100);
  });
  it('writes the decimals that the axis needs', () => {
    expect(tickLabel(-0.5, 0.25)).toBe('−0.50');
    expect(tickLabel(20, 10)).toBe('20');
    expect(clockAt(3600, 60)).toBe('01:00:00');
  });
});

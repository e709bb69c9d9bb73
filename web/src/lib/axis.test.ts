import { describe, expect, it } from 'vitest';
import { clockAt, decades, ticks, timeTicks, written } from './axis';

describe('axes', () => {
  it('puts ticks on round numbers inside the span', () => {
    expect(ticks(0, 1)).toEqual([0, 0.2, 0.4, 0.6, 0.8, 1]);
    expect(ticks(5, 5)).toEqual([]);
    expect(decades(0.05, 200)).toEqual([0.1, 1, 10, 100]);
    expect(timeTicks(0, 300)).toEqual([0, 60, 120, 180, 240, 300]);
  });
  it('writes what the axis needs', () => {
    expect(written(-0.5, 0.25)).toBe('−0.50');
    expect(written(20, 10)).toBe('20');
    expect(clockAt(3600, 60)).toBe('01:00:00');
  });
});

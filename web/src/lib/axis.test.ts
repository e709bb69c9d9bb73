import { describe, expect, it } from 'vitest';
import { clockAt, timeTicks, written } from './axis';

describe('axes', () => {
  it('puts ticks at round times inside the span', () => {
    expect(timeTicks(0, 300)).toEqual([0, 60, 120, 180, 240, 300]);
  });
  it('writes the decimals that the axis needs', () => {
    expect(written(-0.5, 0.25)).toBe('−0.50');
    expect(written(20, 10)).toBe('20');
    expect(clockAt(3600, 60)).toBe('01:00:00');
  });
});

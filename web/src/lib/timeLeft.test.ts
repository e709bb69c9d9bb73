import { describe, expect, it } from 'vitest';
import { TimeLeft } from './timeLeft';

describe('time left', () => {
  it('is that of the progress seen, not of the time since the creation', () => {
    const left = new TimeLeft();
    expect(left.estimate(7, 400, 1000, 1_000_000)).toBeNull();
    expect(left.estimate(7, 500, 1000, 1_010_000)).toBeCloseTo(50);
  });
  it('begins again for other work and after a restart', () => {
    const left = new TimeLeft();
    left.estimate(7, 0, 100, 0);
    expect(left.estimate(8, 50, 100, 1000)).toBeNull();
    expect(left.estimate(8, 60, 100, 2000)).toBeCloseTo(4);
    expect(left.estimate(8, 10, 100, 3000)).toBeNull();
  });
  it('is unknown for complete work', () => {
    const left = new TimeLeft();
    left.estimate(7, 0, 10, 0);
    expect(left.estimate(7, 10, 10, 1000)).toBeNull();
  });
});

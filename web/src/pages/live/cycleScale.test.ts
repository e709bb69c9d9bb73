import { expect, test } from 'vitest';
import { cycleScale, idleMs } from './cycleScale';

test('the bars use the reported period', () => {
  expect(cycleScale(500, [480, 460])).toEqual({ top: 500, ticks: [0, 250, 500] });
  expect(cycleScale(60_000, [480])).toEqual({ top: 60_000, ticks: [0, 30_000, 60_000] });
  expect(cycleScale(500, [700]).top).toBe(700);
  expect([idleMs(500, 480), idleMs(500, 700)]).toEqual([20, 0]);
});

test('without a reported period, nothing is stated about idle time', () => {
  expect(cycleScale(null, [480, 460])).toEqual({ top: 480, ticks: [0, 240, 480] });
  expect(idleMs(null, 480)).toBeNull();
});

import { describe, expect, it, vi } from 'vitest';
import type { FieldDefinition } from '../../api/types';

// uPlot reads the screen when it is loaded; these calculations do not need it.
vi.mock('uplot', () => ({ default: class {} }));
const { axisTexts, yRange, reading, timeText } = await import('./stack');
const field = (watch: [number | null, number | null]): FieldDefinition =>
  ({
    watch,
    warning: [null, null],
    critical: [null, null],
    decimals: 1,
    title: 'Sensor',
  }) as unknown as FieldDefinition;

describe('a plot', () => {
  it('shows a limit that is near its values and not one far away', () => {
    expect(yRange(38, 44, field([null, 45]))[1]).toBeGreaterThan(45);
    expect(yRange(7, 8, field([null, 450]))[1]).toBeLessThan(10);
  });
  it('does not extend below zero for values that never do', () => {
    expect(yRange(0, 20, undefined)[0]).toBe(0);
    expect(yRange(null, null, undefined)).toEqual([0, 1]);
  });
  it('reads the sample at or before the cursor, or the newest without a cursor', () => {
    const s = {
      name: 'a',
      packet: 'p',
      title: 'A',
      unit: 'degC',
      kind: 'number' as const,
      choices: [],
      samples: 3,
      thinned: false,
      resolution_s: 0,
      t: [10, 20, 30],
      y: [1, 2, null],
    };
    expect(reading(s, field([null, null]), 25).value).toBe('2.0');
    expect(reading(s, field([null, null]), null).value).toBe('2.0');
  });
  it('labels its grid with the decimals of the step', () => {
    expect(axisTexts([7, 7.25, 7.5])).toEqual(['7.00', '7.25', '7.50']);
    expect(axisTexts([0, 0.2, 0.4])).toEqual(['0.0', '0.2', '0.4']);
    expect(axisTexts([0, 50, 100])).toEqual(['0', '50', '100']);
    expect(axisTexts([0, 2.5, 5])).toEqual(['0.0', '2.5', '5.0']);
  });
  it('writes times as long as the span needs', () => {
    expect(timeText(1_800_000_000, [0, 60])).toMatch(/^\d\d:\d\d:\d\dZ$/);
    expect(timeText(1_800_000_000, [0, 90_000])).toMatch(/^\d\d-\d\d \d\d:\d\d$/);
  });
});

import { describe, expect, it } from 'vitest';
import { boundsText, digits, valueText } from './sheet';

const figure = (value: number | null, low: number | null, high: number | null, unit: string) => ({
  name: 'x',
  value,
  low,
  high,
  unit,
});

describe('figures of a performance sheet', () => {
  it('have three digits and their sign', () => {
    expect(valueText(figure(-1.23456, -2, 0, 'arcsec'))).toBe('−1.23 ″');
    expect(valueText(figure(97.04, 90, 99, '%'))).toBe('97 %');
    expect(digits(0.0000012)).toBe('1.20e−6');
  });
  it('state an interval without upper bound as a lower one', () => {
    expect(boundsText(figure(1, 0.5, null, 'deg/s'))).toBe('≥ 0.5');
    expect(boundsText(figure(1, 0.5, 2, ''))).toBe('0.5 … 2');
    expect(boundsText(figure(null, null, null, ''))).toBe('–');
  });
});

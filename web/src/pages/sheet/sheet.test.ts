import { describe, expect, it } from 'vitest';
import { conditionsOf, figureText, plainFigures } from './sheet';

const figure = (value: number | null, low: number | null, high: number | null, unit: string, name = 'x') => ({
  name,
  value,
  low,
  high,
  unit,
});

const row = (figures: ReturnType<typeof figure>[]) => ({
  key: 'robustness',
  title: 'Robustness',
  measured: true,
  method: '',
  conditions: '',
  frames: 100,
  needs: '',
  figures,
});

describe('figures of a performance sheet', () => {
  it('have the same decimals as their interval, three digits for the largest number', () => {
    expect(figureText(figure(-1.23456, -2, 0, 'arcsec'))).toEqual({ value: '−1.23 ″', bounds: '−2.00 – 0.00' });
    expect(figureText(figure(97.04, 90, 99, '%'))).toEqual({ value: '97.0 %', bounds: '90.0 – 99.0' });
    expect(figureText(figure(0.00582, -0.0115, 0.0273, 'arcsec/K')).value).toBe('0.0058 ″/K');
  });
  it('state short times in ms or µs', () => {
    expect(figureText(figure(0.0033, -0.00432, 0.00949, 's'))).toEqual({ value: '3.30 ms', bounds: '−4.32 – 9.49' });
    expect(figureText(figure(2.23e-5, -5.89e-5, 9.79e-5, 's'))).toEqual({ value: '22.3 µs', bounds: '−58.9 – 97.9' });
  });
  it('state an interval without upper bound as a lower one', () => {
    expect(figureText(figure(1, 0.5, null, 'deg/s')).bounds).toBe('≥ 0.50');
    expect(figureText(figure(null, null, null, ''))).toEqual({ value: '–', bounds: '–' });
  });
  it('of simulated conditions are grouped by condition', () => {
    const figures = [
      figure(40, 39, 41, 'e/s', 'dark current'),
      figure(92, 85, 96, '%', '20 false stars: correct'),
      figure(16, 14, 18, 'arcsec', '20 false stars: error across'),
      figure(99, 96, 100, '%', 'none: correct'),
    ];
    expect(plainFigures(row(figures)).map((f) => f.name)).toEqual(['dark current']);
    const conditions = conditionsOf(row(figures));
    expect(conditions.map((c) => c.name)).toEqual(['20 false stars', 'none']);
    expect(conditions[0]?.figures['error across']?.value).toBe('16.0 ″');
    expect(conditions[1]?.figures['error across']).toBeUndefined();
  });
});

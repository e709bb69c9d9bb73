/** Text of the figures in a performance sheet. */
import type { SheetFigure } from '../../api/types';

const SIGNS: Readonly<Record<string, string>> = {
  arcsec: '″',
  'arcsec/K': '″/K',
  'arcsec/day': '″/day',
  'deg/s': '°/s',
  'deg/s²': '°/s²',
};

/** Rows of a sheet by the frames that they need, for a user without a sheet. A sheet states the needs of each row. */
export const GUIDE = [
  { frames: 'Frames of several pointings', rows: 'field-of-view spatial error, pixel spatial error, acquisition' },
  { frames: 'At least 22 consecutive frames at equal intervals', rows: 'temporal noise (NEA), tracking' },
  {
    frames: 'Frames of a second head at the same times',
    rows: 'bias with its drift, thermo-elastic error, aberration error, measurement date error',
  },
  { frames: 'Simulated unit', rows: 'also end of life and robustness: rendered frames compared with the truth' },
] as const;

/** Format a number with three significant digits, without an exponent for values from 1e-5 to 1e5. */
export function digits(value: number | null): string {
  if (value === null) return '–';
  if (value === 0) return '0';
  const size = Math.abs(value);
  const text = size >= 1e5 || size < 1e-5 ? value.toExponential(2) : Number(value.toPrecision(3)).toString();
  return text.replaceAll('-', '−');
}

export function valueText(f: SheetFigure): string {
  return `${digits(f.value)} ${SIGNS[f.unit] ?? f.unit}`.trim();
}

export function boundsText(f: SheetFigure): string {
  if (f.low === null && f.high === null) return '–';
  if (f.high === null) return `≥ ${digits(f.low)}`;
  return `${digits(f.low)} … ${digits(f.high)}`;
}

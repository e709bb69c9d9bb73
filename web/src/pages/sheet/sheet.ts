/** Text of the figures in a performance sheet. */
import type { PerformanceSheet, SheetFigure } from '../../api/types';

type SheetRow = PerformanceSheet['rows'][number];

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

export interface FigureText {
  value: string;
  bounds: string;
}

/** Format a figure and its interval. All numbers of the figure have the same decimals, so that the largest has three
 *  digits; short times are in ms or µs. The PDF uses the same rule (sheet_record.py). */
export function figureText(f: SheetFigure): FigureText {
  const largest = Math.max(0, ...[f.value, f.low, f.high].map((v) => Math.abs(v ?? 0)));
  let unit = f.unit;
  let factor = 1;
  if (unit === 's' && largest > 0 && largest < 0.1) [unit, factor] = largest >= 1e-4 ? ['ms', 1e3] : ['µs', 1e6];
  const decimals = largest > 0 ? Math.min(Math.max(2 - Math.floor(Math.log10(largest * factor)), 0), 7) : 2;
  const text = (v: number | null): string => (v === null ? '–' : (v * factor).toFixed(decimals).replace('-', '−'));
  const bounds = f.high !== null ? `${text(f.low)} – ${text(f.high)}` : f.low !== null ? `≥ ${text(f.low)}` : '–';
  return { value: `${text(f.value)} ${SIGNS[unit] ?? unit}`.trim(), bounds };
}

/** One simulated condition of a row ("20 false stars: correct"), with its figures by the name of the quantity. */
export interface Condition {
  name: string;
  figures: Readonly<Record<string, FigureText>>;
}

const OF_CONDITION = ': ';

export function plainFigures(row: SheetRow): SheetFigure[] {
  return row.figures.filter((f) => !f.name.includes(OF_CONDITION));
}

export function conditionsOf(row: SheetRow): Condition[] {
  const conditions = new Map<string, Record<string, FigureText>>();
  for (const f of row.figures) {
    const at = f.name.indexOf(OF_CONDITION);
    if (at < 0) continue;
    const name = f.name.slice(0, at);
    conditions.set(name, { ...conditions.get(name), [f.name.slice(at + OF_CONDITION.length)]: figureText(f) });
  }
  return [...conditions].map(([name, figures]) => ({ name, figures }));
}

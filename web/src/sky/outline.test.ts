import { describe, expect, it } from 'vitest';
import { edgesOf, regionPixels } from './outline';

const columns = 12;
/**
 * A background of 10 with two neighbouring stars; a literal flood fill above a threshold is the independent reference.
 */
const rows = [
  '............',
  '..14........',
  '.2993....5..',
  '.28961..596.',
  '..3741...72.',
  '............',
  '............',
];
const pixels = Uint8Array.from(rows.flatMap((line) => [...line].map((c) => (c === '.' ? 10 : 10 + 20 * Number(c)))));
function flood(start: number, above: number): Set<number> {
  const got = new Set<number>();
  const next = [start];
  for (let p = next.pop(); p !== undefined; p = next.pop()) {
    if (got.has(p) || (pixels[p] ?? 0) <= above) continue;
    got.add(p);
    next.push(p - columns, p + columns, ...(p % columns ? [p - 1] : []), ...(p % columns < columns - 1 ? [p + 1] : []));
  }
  return got;
}
const image = { columns, rows: rows.length, pixels };

describe('the outline of a region', () => {
  it('contains the connected pixels above the threshold without knowing it', () => {
    for (const above of [20, 40, 60, 100, 150])
      for (const peak of [2 * columns + 3, 3 * columns + 9]) {
        const want = flood(peak, above);
        const [cols, lines] = [[...want].map((p) => p % columns), [...want].map((p) => Math.floor(p / columns))];
        const bounds = {
          col_min: Math.min(...cols),
          col_max: Math.max(...cols),
          row_min: Math.min(...lines),
          row_max: Math.max(...lines),
          area_px: want.size,
        };
        expect(regionPixels(image, bounds).sort((a, b) => a - b)).toEqual([...want].sort((a, b) => a - b));
      }
  });
  it('is closed: an even number of edges meets at every corner', () => {
    const meet = new Map<string, number>();
    const edges = edgesOf([...flood(2 * columns + 3, 40)], columns);
    for (const [x0, y0, x1, y1] of edges)
      for (const end of [`${x0} ${y0}`, `${x1} ${y1}`]) meet.set(end, (meet.get(end) ?? 0) + 1);
    expect([...meet.values()].every((n) => n % 2 === 0)).toBe(true);
    expect(edgesOf([0], columns)).toHaveLength(4);
    expect(edgesOf([0, 1], columns)).toHaveLength(6);
  });
  it('stays within the frame and its own bounds', () => {
    expect(regionPixels(image, { col_min: -3, col_max: 1, row_min: 0, row_max: 0, area_px: 50 })).toHaveLength(2);
    expect(regionPixels(image, { col_min: 20, col_max: 30, row_min: 0, row_max: 0, area_px: 5 })).toEqual([]);
  });
});

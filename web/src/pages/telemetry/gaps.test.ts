import { describe, expect, it } from 'vitest';
import { broken, gapsOf, grouped, joined } from './gaps';

describe('series with gaps', () => {
  it('finds only the gap of a steady series', () => {
    expect(gapsOf([0, 1, 2, 3, 10, 11], 0)).toEqual([{ from: 3, to: 10 }]);
    expect(gapsOf([0, 60, 120, 180], 0)).toEqual([]);
  });
  it('finds no gap between the extremes of adjacent bins, and the gap where bins are empty', () => {
    const bins = [0, 1, 2, 3, 6, 7, 8, 9].flatMap((bin) => [bin * 216 + (bin % 2 ? 200 : 0), bin * 216 + 201]);
    expect(gapsOf(bins, 216)).toEqual([{ from: 849, to: 1296 }]);
  });
  it('breaks the line there', () => {
    const [t, y] = broken([0, 1, 2, 9, 10], [1, 1, 1, 2, 2], 0);
    expect(t).toHaveLength(6);
    expect(y).toEqual([1, 1, 1, null, 2, 2]);
  });
  it('joins series of different times without inventing samples', () => {
    expect(
      joined([
        [
          [1, 3],
          [10, 30],
        ],
        [
          [2, 3],
          [5, 6],
        ],
      ]),
    ).toEqual([
      [1, 2, 3],
      [10, undefined, 30],
      [undefined, 5, 6],
    ]);
  });
  it('puts one unit on one plot', () => {
    const s = (name: string, unit: string, kind = 'number') => ({ name, unit, kind });
    expect(
      grouped([s('a', 'degC'), s('n', ''), s('b', 'degC'), s('m', ''), s('e', 'degC', 'enum')]).map((g) =>
        g.map((x) => x.name),
      ),
    ).toEqual([['a', 'b'], ['n'], ['m'], ['e']]);
  });
});

/** Gaps of a series, and the grouping of series in plots. Times are in seconds since 1970. */
export interface Gap {
  from: number;
  to: number;
}
const FACTOR = 4;
const MIN_S = 4;

/**
 * Return the gaps: intervals between samples longer than four seconds and longer than four times the median interval.
 * Times of a series with a resolution are those of the extremes of bins, seconds or two bins apart. Its gaps are
 * intervals longer than twice the resolution.
 */
export function gapsOf(t: readonly number[], resolution_s: number): Gap[] {
  const steps = t.slice(1).map((v, i) => v - (t[i] ?? v));
  const median = [...steps].sort((a, b) => a - b)[Math.floor(steps.length / 2)] ?? 0;
  const longest = Math.max(MIN_S, resolution_s > 0 ? 2 * resolution_s : FACTOR * median);
  return steps.flatMap((s, i) => (s > longest ? [{ from: t[i] ?? 0, to: t[i + 1] ?? 0 }] : []));
}

/** Return the series with a null after the start of each gap, so that no line crosses the gap. */
export function broken(
  t: readonly number[],
  y: readonly (number | null)[],
  resolution_s: number,
): [number[], (number | null)[]] {
  const gaps = gapsOf(t, resolution_s);
  const ts: number[] = [];
  const ys: (number | null)[] = [];
  t.forEach((v, i) => {
    ts.push(v);
    ys.push(y[i] ?? null);
    if (gaps[0]?.from === v) {
      ts.push(v + 1e-3);
      ys.push(null);
      gaps.shift();
    }
  });
  return [ts, ys];
}

/**
 * Align several series on one time axis that contains the times of all series. A series without a sample at a time has
 * `undefined`, with a break `null`.
 */
export function joined(
  series: readonly (readonly [readonly number[], readonly (number | null)[]])[],
): [number[], ...(number | null | undefined)[][]] {
  const times = [...new Set(series.flatMap(([t]) => t))].sort((a, b) => a - b);
  const at = new Map(times.map((t, i) => [t, i]));
  const columns = series.map(([t, y]) => {
    const column: (number | null | undefined)[] = new Array<undefined>(times.length).fill(undefined);
    t.forEach((v, i) => {
      column[at.get(v) ?? 0] = y[i];
    });
    return column;
  });
  return [times, ...columns];
}

/**
 * Group series in plots. At most three numeric series with the same unit share a plot; series without a unit have
 * separate plots.
 */
export function grouped<T extends { unit: string; kind: string }>(list: readonly T[], maxSeries = 3): T[][] {
  const out: T[][] = [];
  for (const s of list) {
    const group =
      s.unit !== '' && s.kind === 'number'
        ? out.find((g) => g[0]?.unit === s.unit && g[0].kind === 'number' && g.length < maxSeries)
        : undefined;
    if (group) group.push(s);
    else out.push([s]);
  }
  return out;
}

/** Gaps of a series, and how plots share an axis. Times in seconds since 1970. */
export interface Gap {
  from: number;
  to: number;
}
const FACTOR = 4;
const MIN_S = 4;

/** Spans between samples much longer than usual: at least four times the median step and at least four seconds. */
export function gapsOf(t: readonly number[]): Gap[] {
  const steps = t.slice(1).map((v, i) => v - (t[i] ?? v));
  const usual = [...steps].sort((a, b) => a - b)[Math.floor(steps.length / 2)] ?? 0;
  return steps.flatMap((s, i) => (s > Math.max(MIN_S, FACTOR * usual) ? [{ from: t[i] ?? 0, to: t[i + 1] ?? 0 }] : []));
}

/** The same series with a break in each gap, so that no line crosses it. */
export function broken(t: readonly number[], y: readonly (number | null)[]): [number[], (number | null)[]] {
  const gaps = gapsOf(t);
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
 * Several series on one time axis: every time of any of them; `undefined` where a series has no sample, `null` where
 * it has a break.
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
 * Adjacent parameters with one unit share a plot, at most three; words and counts without a unit have separate plots.
 */
export function grouped<T extends { unit: string; kind: string }>(list: readonly T[], most = 3): T[][] {
  const out: T[][] = [];
  for (const s of list) {
    const with_ =
      s.unit !== '' && s.kind === 'number'
        ? out.find((g) => g[0]?.unit === s.unit && g[0].kind === 'number' && g.length < most)
        : undefined;
    if (with_) with_.push(s);
    else out.push([s]);
  }
  return out;
}

/** Scale of the bars of the cycle, in milliseconds. */
export interface CycleScale {
  top: number;
  ticks: readonly number[];
}

/** Return a scale for the durations of iterations. It contains the period of the cycle if this is reported. */
export function cycleScale(periodMs: number | null, totalsMs: readonly number[]): CycleScale {
  const top = Math.max(periodMs ?? 1, ...totalsMs);
  const end = periodMs ?? top;
  return { top, ticks: [0, end / 2, end] };
}

/** Return the part of the period that an iteration did not use; null if the period is not reported. */
export function idleMs(periodMs: number | null, totalMs: number): number | null {
  return periodMs === null ? null : Math.max(0, periodMs - totalMs);
}

const DAY_S = 86400;
/** Room for the label of a tick. */
const LABEL_PX = 84;
const CHARACTER_PX = 6.4;
const DAYS = [1, 2, 7, 14, 30, 60, 120, 365];

/**
 * Return round times for the ticks of a time axis, in Unix seconds: at most about six, fewer if `widthPx` has less room
 * for their labels. plot.ts has the ticks of other axes.
 */
export function timeTicks(low: number, high: number, widthPx = Infinity): number[] {
  const most = Math.max(2, Math.min(6, Math.floor(widthPx / LABEL_PX)));
  const step =
    [1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600, 43200, ...DAYS.map((d) => d * DAY_S)].find(
      (s) => (high - low) / s <= most,
    ) ?? 1461 * DAY_S;
  const out: number[] = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) out.push(k * step);
  return out;
}

/**
 * Return the ends of the axis of values with their intervals; `high` is null without an upper bound. The PDF uses the
 * same rule (draw_intervals.py).
 */
export function intervalAxis(
  lines: readonly { value: number; low: number; high: number | null }[],
  log: boolean,
): [number, number] {
  const largest = 1.05 * Math.max(...lines.flatMap((l) => [l.value, l.low, l.high ?? 0])) || 1;
  const positive = lines.map((l) => l.value).filter((v) => v > 0);
  return log ? [Math.min(largest, ...positive) / 3, largest] : [0, largest];
}

/** Return the middle of a tick label: the tick `x`, or less where the label would pass the right edge at `widthPx`. */
export function labelMiddle(x: number, label: string, widthPx: number): number {
  return Math.min(x, widthPx - (label.length * CHARACTER_PX) / 2 - 2);
}

/** Return the number as text, with the decimals that the step of the axis needs and a true minus sign. */
export function tickLabel(value: number, step: number): string {
  if (value === 0) return '0';
  const size = Math.abs(value);
  if (size < 1e-4 || size >= 1e6) return value.toExponential(1).replace('-', '−');
  const digits = Math.max(
    0,
    -Math.floor(Math.log10(step || 1) + 1e-9) +
      (Math.abs(step / 10 ** Math.floor(Math.log10(step || 1)) - 2.5) < 1e-6 ? 1 : 0),
  );
  return value.toFixed(Math.min(6, digits)).replace('-', '−');
}

export function clockAt(unix: number, span: number): string {
  const iso = new Date(unix * 1000).toISOString();
  if (span > 12 * DAY_S) return iso.slice(0, 10);
  return span < 3600 ? iso.slice(11, 19) : span < 86400 ? iso.slice(11, 16) : iso.slice(5, 16).replace('T', ' ');
}

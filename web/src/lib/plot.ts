/** Scale of a plot axis, linear or logarithmic. `place` returns the position of a value, 0 at `low` and 1 at `high`. */
export interface Scale {
  low: number;
  high: number;
  log: boolean;
  place: (v: number) => number;
}

export function scale(low: number, high: number, log = false, room = false): Scale {
  let [a, b] = [low, high];
  if (log) {
    a = Math.max(a, 1e-12);
    b = Math.max(b, a * 1.0001);
  }
  if (!(b > a)) [a, b] = [a - 0.5, b + 0.5];
  if (room) b = log ? b * Math.pow(b / a, 0.04) : b + (b - a) * 0.04;
  const span = log ? Math.log(b / a) : b - a;
  return { low: a, high: b, log, place: (v) => (log ? Math.log(Math.max(v, 1e-300) / a) / span : (v - a) / span) };
}

/** Return about `count` round values inside the scale. */
export function ticks(s: Scale, count: number): number[] {
  if (s.log && s.high / s.low >= 8) {
    const all: number[] = [];
    const decades = Math.log10(s.high / s.low);
    const steps = decades * 3 <= count + 1 ? [1, 2, 5] : [1];
    const skip = steps.length === 1 ? Math.max(1, Math.ceil(decades / count)) : 1;
    for (let e = Math.floor(Math.log10(s.low)); e <= Math.ceil(Math.log10(s.high)); e += skip)
      for (const m of steps) all.push(m * 10 ** e);
    return all.map((v) => Number(v.toPrecision(6))).filter((v) => v >= s.low * 0.9999 && v <= s.high * 1.0001);
  }
  const raw = (s.high - s.low) / Math.max(1, count);
  const unit = 10 ** Math.floor(Math.log10(raw));
  const step = ([1, 2, 5, 10].find((m) => m * unit >= raw) ?? 10) * unit;
  const first = Math.ceil(s.low / step - 1e-9);
  const last = Math.floor(s.high / step + 1e-9);
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, k) => Number(((first + k) * step).toPrecision(10)));
}

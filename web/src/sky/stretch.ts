/** Conversion of raw values to grey levels: black and white points, linear or asinh, optionally inverted. */
export interface Stretch {
  low: number;
  high: number;
  kind: 'asinh' | 'linear';
  invert: boolean;
}
const SOFT = 8;

/** Return the grey level of a value, 0 … 255. */
export function grey(value: number, s: Stretch): number {
  const t = Math.min(1, Math.max(0, (value - s.low) / Math.max(1e-9, s.high - s.low)));
  const bent = s.kind === 'asinh' ? Math.asinh(t * SOFT) / Math.asinh(SOFT) : t;
  const level = Math.round(bent * 255);
  return s.invert ? 255 - level : level;
}

/** Return the grey levels of all values of an image, so that each pixel needs only a lookup. */
export function table(maxStep: number, s: Stretch, offset = 0, scale = 1): Uint8ClampedArray {
  const out = new Uint8ClampedArray(maxStep + 1);
  for (let step = 0; step <= maxStep; step++) out[step] = grey(offset + scale * step, s);
  return out;
}

export function paint(
  pixels: Uint8Array | Uint16Array,
  levels: Uint8ClampedArray,
  invert: boolean,
  out: Uint8ClampedArray,
): void {
  const target = new Uint32Array(out.buffer, out.byteOffset, out.byteLength / 4);
  const colours = new Uint32Array(levels.length);
  for (let v = 0; v < levels.length; v++) {
    // Tinted with the background colour instead of pure black or white (little endian: ABGR).
    const g = levels[v] ?? 0;
    const [r, gr, b] = invert
      ? [(g * 0.965) | 0, (g * 0.97) | 0, (g * 0.975) | 0]
      : [6 + g * 0.965, 8 + g * 0.962, 11 + g * 0.95].map((c) => Math.min(255, c | 0));
    colours[v] = (255 << 24) | ((b ?? 0) << 16) | ((gr ?? 0) << 8) | (r ?? 0);
  }
  const last = levels.length - 1;
  for (let i = 0; i < pixels.length; i++) target[i] = colours[Math.min(last, pixels[i] ?? 0)] ?? 0;
}

/** Conversion of raw values to grey: black and white points, linear or asinh, optionally inverted. */
export interface Stretch {
  low: number;
  high: number;
  kind: 'asinh' | 'linear';
  invert: boolean;
}
const SOFT = 8;

/** 0…255 for one value. */
export function grey(value: number, s: Stretch): number {
  const t = Math.min(1, Math.max(0, (value - s.low) / Math.max(1e-9, s.high - s.low)));
  const bent = s.kind === 'asinh' ? Math.asinh(t * SOFT) / Math.asinh(SOFT) : t;
  const level = Math.round(bent * 255);
  return s.invert ? 255 - level : level;
}

/** A table over all values of the image, so that each pixel is one lookup. */
export function table(maxStep: number, s: Stretch, offset = 0, scale = 1): Uint8ClampedArray {
  const out = new Uint8ClampedArray(maxStep + 1);
  for (let step = 0; step <= maxStep; step++) out[step] = grey(offset + scale * step, s);
  return out;
}

export function paint(
  pixels: Uint8Array | Uint16Array,
  look: Uint8ClampedArray,
  invert: boolean,
  out: Uint8ClampedArray,
): void {
  const words = new Uint32Array(out.buffer, out.byteOffset, out.byteLength / 4);
  const colours = new Uint32Array(look.length);
  for (let v = 0; v < look.length; v++) {
    // A trace of the background colour instead of pure black or white (little endian: ABGR).
    const g = look[v] ?? 0;
    const [r, gr, b] = invert
      ? [(g * 0.965) | 0, (g * 0.97) | 0, (g * 0.975) | 0]
      : [6 + g * 0.965, 8 + g * 0.962, 11 + g * 0.95].map((c) => Math.min(255, c | 0));
    colours[v] = (255 << 24) | ((b ?? 0) << 16) | ((gr ?? 0) << 8) | (r ?? 0);
  }
  const last = look.length - 1;
  for (let i = 0; i < pixels.length; i++) words[i] = colours[Math.min(last, pixels[i] ?? 0)] ?? 0;
}

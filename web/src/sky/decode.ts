/**
 * Convert the bytes of a frame to a paintable image. Runs in a worker for floating-point images, because many
 * megapixels take time.
 */
export interface Decoded {
  pixels: Uint8Array<ArrayBuffer> | Uint16Array<ArrayBuffer>;
  offset: number;
  scale: number;
}

export function decode(buffer: ArrayBuffer, dtype: string, count: number): Decoded {
  const float = dtype.includes('float') || buffer.byteLength >= count * 4;
  if (!float)
    return {
      pixels: buffer.byteLength >= count * 2 ? new Uint16Array(buffer) : new Uint8Array(buffer),
      offset: 0,
      scale: 1,
    };
  const values = buffer.byteLength >= count * 8 ? new Float64Array(buffer) : new Float32Array(buffer);
  let low = Infinity;
  let high = -Infinity;
  for (const v of values)
    if (Number.isFinite(v)) {
      low = Math.min(low, v);
      high = Math.max(high, v);
    }
  if (!(low < high)) [low, high] = [Number.isFinite(low) ? low : 0, (Number.isFinite(low) ? low : 0) + 1];
  const scale = (high - low) / 65535;
  const pixels = new Uint16Array(values.length);
  for (let i = 0; i < values.length; i++)
    pixels[i] = Number.isFinite(values[i]) ? Math.round(((values[i] ?? 0) - low) / scale) : 0;
  return { pixels, offset: low, scale };
}

/** Pixels of a region, reconstructed from the raw image, and their outline. */
import type { RawImage } from '../api/pixels';

export interface Bounds {
  col_min: number;
  row_min: number;
  col_max: number;
  row_max: number;
  area_px: number;
}
/** Edge of a pixel: (col, row, col, row) of its two ends. A pixel covers its number ± 0.5. */
export type Edge = readonly [number, number, number, number];

/**
 * Return the pixel indices of a region from its bounds and area. Starting at the brightest pixel, the brightest
 * neighbour is added until the area is reached. A region is the connected set of pixels above a threshold around its
 * peak. Each of its pixels is brighter than any neighbour outside, so this order finds exactly this set without the
 * threshold.
 */
export function regionPixels(image: Pick<RawImage, 'columns' | 'rows' | 'pixels'>, region: Bounds): number[] {
  const [left, right] = [Math.max(0, region.col_min), Math.min(image.columns - 1, region.col_max)];
  const [top, bottom] = [Math.max(0, region.row_min), Math.min(image.rows - 1, region.row_max)];
  if (left > right || top > bottom) return [];
  const value = (p: number): number => image.pixels[p] ?? 0;
  let peak = top * image.columns + left;
  for (let row = top; row <= bottom; row++)
    for (let col = left; col <= right; col++) {
      const p = row * image.columns + col;
      if (value(p) > value(peak)) peak = p;
    }
  const inside = new Set<number>();
  const rim = new Set<number>([peak]);
  while (inside.size < region.area_px && rim.size) {
    let best = -1;
    for (const p of rim) if (best < 0 || value(p) > value(best)) best = p;
    rim.delete(best);
    inside.add(best);
    const [col, row] = [best % image.columns, Math.floor(best / image.columns)];
    if (col > left && !inside.has(best - 1)) rim.add(best - 1);
    if (col < right && !inside.has(best + 1)) rim.add(best + 1);
    if (row > top && !inside.has(best - image.columns)) rim.add(best - image.columns);
    if (row < bottom && !inside.has(best + image.columns)) rim.add(best + image.columns);
  }
  return [...inside];
}

/** Return the edges between a pixel of the set and a pixel outside it. */
export function edgesOf(pixels: readonly number[], columns: number): Edge[] {
  const inside = new Set(pixels);
  const edges: Edge[] = [];
  for (const p of pixels) {
    const [col, row] = [p % columns, Math.floor(p / columns)];
    const [l, t, r, b] = [col - 0.5, row - 0.5, col + 0.5, row + 0.5];
    if (col === 0 || !inside.has(p - 1)) edges.push([l, t, l, b]);
    if (col === columns - 1 || !inside.has(p + 1)) edges.push([r, t, r, b]);
    if (!inside.has(p - columns)) edges.push([l, t, r, t]);
    if (!inside.has(p + columns)) edges.push([l, b, r, b]);
  }
  return edges;
}

const cache = new WeakMap<object, { image: object; edges: Edge[] }>();

/** Return the outline of a region in this image. Cached while region and image exist. */
export function outlineOf(image: RawImage, region: Bounds): Edge[] {
  const cached = cache.get(region);
  if (cached?.image === image) return cached.edges;
  const edges = edgesOf(regionPixels(image, region), image.columns);
  cache.set(region, { image, edges });
  return edges;
}

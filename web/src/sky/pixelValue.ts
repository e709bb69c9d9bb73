/** Value of a pixel of a frame. */
import type { RawImage } from '../api/pixels';
import type { Frame } from '../api/types';

/** True if the pixel was received. The image marks the other pixels, see overlay/missing. */
export function isReceived(frame: Pick<Frame, 'complete' | 'held' | 'rows_held'>, col: number, row: number): boolean {
  if (frame.complete) return true;
  return frame.held.length
    ? frame.held.some(([c, r, columns, rows]) => col >= c && col < c + columns && row >= r && row < r + rows)
    : frame.rows_held.some(([first, last]) => row >= first && row <= last);
}

/** Return the value of a pixel in DN; null outside the image, and for a pixel that was not received. */
export function pixelValue(
  image: RawImage,
  frame: Parameters<typeof isReceived>[0] | null,
  col: number,
  row: number,
): number | null {
  const isInside = col >= 0 && row >= 0 && col < image.columns && row < image.rows;
  if (!isInside || (frame && !isReceived(frame, col, row))) return null;
  return image.offset + image.scale * (image.pixels[row * image.columns + col] ?? 0);
}

/**
 * Worker that decodes and paints frames. It keeps the last image, so that a new stretch needs no transfer of pixels.
 */
import { decode } from './decode';
import { paint, table, type Stretch } from './stretch';

export interface PaintJob {
  id: number;
  kind: 'paint';
  image: number;
  stretch: Stretch;
  newPixels: { columns: number; rows: number; pixels: Uint8Array | Uint16Array; offset: number; scale: number } | null;
}
export interface DecodeJob {
  id: number;
  kind: 'decode';
  buffer: ArrayBuffer;
  dtype: string;
  count: number;
}

let lastImage: { image: number; newPixels: NonNullable<PaintJob['newPixels']> } | null = null;

function painted(job: PaintJob): ImageBitmap | null {
  if (job.newPixels) lastImage = { image: job.image, newPixels: job.newPixels };
  if (lastImage?.image !== job.image) return null;
  const { columns, rows, pixels, offset, scale } = lastImage.newPixels;
  const canvas = new OffscreenCanvas(columns, rows);
  const ctx = canvas.getContext('2d');
  if (!ctx) return null;
  const data = ctx.createImageData(columns, rows);
  paint(
    pixels,
    table(pixels instanceof Uint8Array ? 255 : 65535, job.stretch, offset, scale),
    job.stretch.invert,
    data.data,
  );
  ctx.putImageData(data, 0, 0);
  return canvas.transferToImageBitmap();
}

addEventListener('message', (e: MessageEvent<PaintJob | DecodeJob>) => {
  const job = e.data;
  if (job.kind === 'decode') {
    const decoded = decode(job.buffer, job.dtype, job.count);
    postMessage({ id: job.id, decoded }, { transfer: [decoded.pixels.buffer] });
    return;
  }
  const bitmap = painted(job);
  postMessage({ id: job.id, bitmap }, { transfer: bitmap ? [bitmap] : [] });
});

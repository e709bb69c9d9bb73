/** Decodes and paints frames outside the page's thread. Keeps the last image, so that a new stretch sends no pixels. */
import { decode } from './decode';
import { paint, table, type Stretch } from './stretch';

export interface PaintJob {
  turn: number;
  kind: 'paint';
  image: number;
  stretch: Stretch;
  fresh: { columns: number; rows: number; pixels: Uint8Array | Uint16Array; offset: number; scale: number } | null;
}
export interface DecodeJob {
  turn: number;
  kind: 'decode';
  buffer: ArrayBuffer;
  dtype: string;
  count: number;
}

let held: { image: number; fresh: NonNullable<PaintJob['fresh']> } | null = null;

function painted(job: PaintJob): ImageBitmap | null {
  if (job.fresh) held = { image: job.image, fresh: job.fresh };
  if (held?.image !== job.image) return null;
  const { columns, rows, pixels, offset, scale } = held.fresh;
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
    const done = decode(job.buffer, job.dtype, job.count);
    postMessage({ turn: job.turn, decoded: done }, { transfer: [done.pixels.buffer] });
    return;
  }
  const bitmap = painted(job);
  postMessage({ turn: job.turn, bitmap }, { transfer: bitmap ? [bitmap] : [] });
});

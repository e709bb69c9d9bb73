/**
 * Interface to the painter, a worker for all images. An image that is requested during painting replaces the waiting
 * image.
 */
import type { RawImage } from '../api/pixels';
import type { Decoded } from './decode';
import type { DecodeJob, PaintJob } from './painter.worker';
import type { Stretch } from './stretch';

interface Answer {
  id: number;
  bitmap?: ImageBitmap | null;
  decoded?: Decoded;
}
let worker: Worker | null = null;
let id = 0;
const waiting = new Map<number, (answer: Answer) => void>();
const numbers = new WeakMap<RawImage, number>();
let last = 0;
let sent: number | null = null;

function ask(job: (id: number) => PaintJob | DecodeJob, transfer: Transferable[] = []): Promise<Answer> {
  worker ??= (() => {
    const w = new Worker(new URL('./painter.worker.ts', import.meta.url), { type: 'module' });
    w.onmessage = (e: MessageEvent<Answer>) => {
      waiting.get(e.data.id)?.(e.data);
      waiting.delete(e.data.id);
    };
    return w;
  })();
  const jobId = ++id;
  return new Promise((resolve) => {
    waiting.set(jobId, resolve);
    worker?.postMessage(job(jobId), transfer);
  });
}

/** Decode the bytes of a floating-point frame in the worker. */
export async function decodeInWorker(buffer: ArrayBuffer, dtype: string, count: number): Promise<Decoded> {
  const { decoded } = await ask((t) => ({ id: t, kind: 'decode', buffer, dtype, count }), [buffer]);
  if (!decoded) throw new Error('the image could not be decoded');
  return decoded;
}

async function paintOnce(image: RawImage, stretch: Stretch): Promise<ImageBitmap | null> {
  const number = numbers.get(image) ?? ++last;
  numbers.set(image, number);
  const { columns, rows, pixels, offset, scale } = image;
  const newPixels = sent === number ? null : { columns, rows, pixels, offset, scale };
  sent = number;
  const { bitmap } = await ask((t) => ({ id: t, kind: 'paint', image: number, stretch, newPixels }));
  return bitmap ?? null;
}

/** Paint for one canvas. Calls `ready` with the last requested image; outdated images are skipped. */
export class Painter {
  private busy = false;
  private next: { image: RawImage; stretch: Stretch } | null = null;
  constructor(private readonly ready: (image: RawImage, stretch: Stretch, bitmap: ImageBitmap) => void) {}

  request(image: RawImage, stretch: Stretch): void {
    this.next = { image, stretch: { ...stretch } };
    if (!this.busy) void this.run();
  }

  private async run(): Promise<void> {
    this.busy = true;
    for (let job = this.next; job; job = this.next) {
      this.next = null;
      const bitmap = await paintOnce(job.image, job.stretch);
      if (bitmap) this.ready(job.image, job.stretch, bitmap);
    }
    this.busy = false;
  }
}

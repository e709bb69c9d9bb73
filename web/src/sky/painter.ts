/**
 * The page's interface to the painter: one worker for all images; an image requested while another is painted replaces
 * the waiting one.
 */
import type { RawImage } from '../api/client';
import type { Decoded } from './decode';
import type { DecodeJob, PaintJob } from './painter.worker';
import type { Stretch } from './stretch';

interface Answer {
  turn: number;
  bitmap?: ImageBitmap | null;
  decoded?: Decoded;
}
let worker: Worker | null = null;
let turn = 0;
const waiting = new Map<number, (answer: Answer) => void>();
const numbers = new WeakMap<RawImage, number>();
let last = 0;
let sent: number | null = null;

function ask(job: (turn: number) => PaintJob | DecodeJob, transfer: Transferable[] = []): Promise<Answer> {
  worker ??= (() => {
    const w = new Worker(new URL('./painter.worker.ts', import.meta.url), { type: 'module' });
    w.onmessage = (e: MessageEvent<Answer>) => {
      waiting.get(e.data.turn)?.(e.data);
      waiting.delete(e.data.turn);
    };
    return w;
  })();
  const mine = ++turn;
  return new Promise((resolve) => {
    waiting.set(mine, resolve);
    worker?.postMessage(job(mine), transfer);
  });
}

/** Values to paint, from the bytes of a floating-point frame. */
export async function decodeAside(buffer: ArrayBuffer, dtype: string, count: number): Promise<Decoded> {
  const { decoded } = await ask((t) => ({ turn: t, kind: 'decode', buffer, dtype, count }), [buffer]);
  if (!decoded) throw new Error('the picture could not be decoded');
  return decoded;
}

async function paintOnce(image: RawImage, stretch: Stretch): Promise<ImageBitmap | null> {
  const number = numbers.get(image) ?? ++last;
  numbers.set(image, number);
  const { columns, rows, pixels, offset, scale } = image;
  const fresh = sent === number ? null : { columns, rows, pixels, offset, scale };
  sent = number;
  const { bitmap } = await ask((t) => ({ turn: t, kind: 'paint', image: number, stretch, fresh }));
  return bitmap ?? null;
}

/** Paints for one canvas: calls `ready` with the newest requested image and skips outdated ones. */
export class Painter {
  private busy = false;
  private next: { image: RawImage; stretch: Stretch } | null = null;
  constructor(private readonly ready: (image: RawImage, stretch: Stretch, bitmap: ImageBitmap) => void) {}

  want(image: RawImage, stretch: Stretch): void {
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

/** Pixels of a frame as the server stores them. */
import { decode } from '../sky/decode';
import { decodeInWorker } from '../sky/painter';
import { readBody, type Received } from '../lib/received';
import { http } from './http';

export interface RawImage {
  columns: number;
  rows: number;
  bits: number;
  /** Values to paint. For an integer image: its pixel values. For a floating-point image: 16-bit steps. */
  pixels: Uint8Array | Uint16Array;
  /** DN of a step: `offset + scale · step`. */
  offset: number;
  scale: number;
}

/** `began`: called with the hash of the pixels when the response begins. `report`: see readBody. */
export interface RawObserver {
  signal: AbortSignal;
  began: (sha256: string) => void;
  report: (received: Received) => void;
}

/** Return the pixels of a frame. */
export async function rawPixels(frame_id: number, { signal, began, report }: RawObserver): Promise<RawImage> {
  const path = { frame_id };
  const { response } = await http.GET('/api/frames/{frame_id}/raw', { params: { path }, parseAs: 'stream', signal });
  const header = (name: string): string | null => response.headers.get(name);
  began(header('X-Sha256') ?? '');
  const [columns, rows, bits] = [Number(header('X-Columns')), Number(header('X-Rows')), Number(header('X-Bits'))];
  const [buffer, dtype, count] = [await readBody(response, report), header('X-Dtype') ?? '', columns * rows];
  const decoder = buffer.byteLength >= count * 4 ? decodeInWorker : decode;
  return { columns, rows, bits, ...(await decoder(buffer, dtype, count)) };
}

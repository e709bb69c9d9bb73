import { afterEach, describe, expect, it, vi } from 'vitest';
import { readBody, receivedWords, type Received } from './received';

/** Response whose parts are received one per `partMs`. */
function slowResponse(parts: number[][], partMs: number, headers: Record<string, string>): Response {
  let now = 0;
  vi.spyOn(performance, 'now').mockImplementation(() => now);
  const rest = [...parts];
  const body = new ReadableStream<Uint8Array>(
    {
      pull(controller) {
        const part = rest.shift();
        now += partMs;
        if (part) controller.enqueue(new Uint8Array(part));
        else controller.close();
      },
    },
    { highWaterMark: 0 },
  );
  return new Response(body, { headers });
}
async function read(parts: number[][], partMs: number, headers: Record<string, string>) {
  const reports: Received[] = [];
  const buffer = await readBody(slowResponse(parts, partMs, headers), (r) => reports.push(r));
  return { reports, bytes: [...new Uint8Array(buffer)] };
}
afterEach(() => vi.restoreAllMocks());

describe('the body of a response', () => {
  it('is counted while it is received slowly', async () => {
    const { reports, bytes } = await read([[1, 2], [3], [4, 5]], 200, { 'Content-Length': '5' });
    expect(bytes).toEqual([1, 2, 3, 4, 5]);
    expect(reports).toEqual([
      { bytes: 3, total: 5 },
      { bytes: 5, total: 5 },
    ]);
  });
  it('is not reported if it is received at once', async () => {
    expect((await read([[1], [2]], 10, { 'Content-Length': '2' })).reports).toEqual([]);
  });
  it('has no total if the length is that of compressed content', async () => {
    const { reports } = await read([[1]], 400, { 'Content-Length': '9', 'Content-Encoding': 'gzip' });
    expect(reports).toEqual([{ bytes: 1, total: null }]);
  });
  it('is described with received and total bytes', () => {
    expect(receivedWords({ bytes: 1_200_000, total: 4_000_000 })).toBe('1.1 MiB of 3.8 MiB');
    expect(receivedWords({ bytes: 1_200_000, total: null })).toBe('1.1 MiB received');
  });
});

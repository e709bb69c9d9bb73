import { describe, expect, it, vi } from 'vitest';
import { ApiError } from '../../api/client';
import type { FrameDetail } from '../../api/types';
import { ImportQueue } from './importQueue.svelte';

const file = (name: string): File => new File(['x'], name);
const problem = (message: string) => ({ id: '', message, expected: '', got: '', hint: '' });
const stored = (id: number): FrameDetail => ({ id }) as unknown as FrameDetail;

describe('the import queue', () => {
  it('sends every image in turn and names what it rejects or leaves out', async () => {
    const sent: string[] = [];
    const queue = new ImportQueue((one) => {
      sent.push(one.name);
      if (one.name === 'bad.png') return Promise.reject(new ApiError(422, problem('bad.png cannot be read')));
      return Promise.resolve(stored(sent.length));
    });
    queue.add([file('a.fits'), file('bad.png'), file('notes.txt'), file('b.JPG')], 'cubestar');
    await vi.waitFor(() => expect(queue.working).toBe(false));
    expect(sent).toEqual(['a.fits', 'b.JPG', 'bad.png']);
    expect(queue.stored.map((f) => f.id)).toEqual([1, 2]);
    expect(queue.rejected.map((r) => r.reason)).toEqual(['bad.png cannot be read']);
    expect([queue.leftOut, queue.total]).toEqual([1, 3]);
  });
  it('sends the files in the order of their names', async () => {
    const sent: string[] = [];
    const queue = new ImportQueue((one) => Promise.resolve(stored(sent.push(one.name))));
    queue.add([file('sky-10.fits'), file('sky-9.fits'), file('sky-1.fits')], '');
    await vi.waitFor(() => expect(queue.stored.length).toBe(3));
    expect(sent).toEqual(['sky-1.fits', 'sky-9.fits', 'sky-10.fits']);
  });
  it('waits while the server does not answer, and loses nothing', async () => {
    let answers = false;
    const queue = new ImportQueue(() =>
      answers ? Promise.resolve(stored(1)) : Promise.reject(new ApiError(0, problem('No answer from the server.'))),
    );
    queue.add([file('a.png'), file('b.png')], '');
    await vi.waitFor(() => expect(queue.stopped).toContain('No answer'));
    expect([queue.waiting.length, queue.rejected.length]).toEqual([2, 0]);
    answers = true;
    queue.resume();
    await vi.waitFor(() => expect(queue.stored.length).toBe(2));
    expect(queue.stopped).toBe('');
  });
  it('drops what waits when it is cancelled', async () => {
    const answers: ((frame: FrameDetail) => void)[] = [];
    const queue = new ImportQueue(() => new Promise((resolve) => answers.push(resolve)));
    queue.add([file('a.png'), file('b.png')], '');
    queue.cancel();
    answers[0]?.(stored(1));
    await vi.waitFor(() => expect(queue.working).toBe(false));
    expect([queue.stored.length, queue.waiting.length, answers.length]).toEqual([1, 0, 1]);
  });
});

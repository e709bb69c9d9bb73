import { describe, expect, it } from 'vitest';
import { PAGE_SIZE, unusable, type Listed } from './frameCheck';

/** Frames 1 … `last`, newest first in pages, of which the `partial` ones have missing rows. */
function store(last: number, partial: readonly number[] = []) {
  const frames: Listed[] = Array.from({ length: last }, (_, k) => ({
    id: last - k,
    complete: !partial.includes(last - k),
  }));
  const offsets: number[] = [];
  const read = async (offset: number) => {
    offsets.push(offset);
    return { total: last, frames: frames.slice(offset, offset + PAGE_SIZE) };
  };
  return { read, offsets };
}

describe('the check of typed frame numbers', () => {
  it('names partial frames before the request is sent', async () => {
    expect(await unusable([3, 4, 5, 9], store(20, [4, 5, 12]).read)).toBe(
      'Rows are missing in frames 4-5. Download the missing rows, or remove these frames from the list.',
    );
    expect(await unusable([12], store(20, [12]).read)).toContain('Rows are missing in frame 12.');
  });
  it('names frames that are not stored', async () => {
    expect(await unusable([19, 20, 21, 30], store(20).read)).toBe('Not stored: frames 21, 30.');
  });
  it('reads further pages only until all frames are listed', async () => {
    const s = store(1200, [100]);
    expect(await unusable([1200, 900], s.read)).toBe('');
    expect(s.offsets).toEqual([0]);
    expect(await unusable([100], s.read)).toContain('frame 100.');
    expect(s.offsets).toEqual([0, 0, 500, 1000]);
  });
  it('states nothing about frames that it did not read', async () => {
    const s = store(5000, [1]);
    expect(await unusable([1], s.read)).toBe('');
    expect(s.offsets).toHaveLength(4);
  });
});

import { describe, expect, it } from 'vitest';
import { merged, UpdateLog } from './snapshot';

describe('a snapshot and the stream', () => {
  it('keeps what the stream reported while the snapshot was loading', () => {
    const updates = new UpdateLog();
    updates.note('command', { id: 1 });
    const during = updates.begin();
    updates.note('command', { id: 9 });
    updates.note('command', { id: 11 });
    updates.note('link', { utc: '' });
    const held = [
      { id: 11, result: 'sent' },
      { id: 9, result: 'completed' },
      { id: 1, result: 'old' },
    ];
    const read = [
      { id: 9, result: 'started' },
      { id: 1, result: 'completed' },
    ];
    expect(merged('command', read, held, during)).toEqual([held[0], held[1], read[1]]);
    expect(during.has('link')).toBe(true);
  });
  it('is forgotten when the snapshot has arrived', () => {
    const updates = new UpdateLog();
    const during = updates.begin();
    updates.end(during);
    updates.note('command', { id: 9 });
    expect(during.size).toBe(0);
  });
  it('does not bring back a row that the stream closed', () => {
    expect(merged('alarm', [{ id: 3 }, { id: 2 }], [], new Set(['alarm 3']))).toEqual([{ id: 2 }]);
  });
});

import { describe, expect, it } from 'vitest';
import { MOST_ENDED, unlessEnded } from './upsert';

const item = (id: number, finished: string | null) => ({ id, finished, state: finished ? 'verified' : 'transferring' });

describe('a list of transfers or jobs', () => {
  it('keeps the newest ended items and all that are in progress', () => {
    let list = [item(0, null)];
    for (let id = 1; id <= 2 * MOST_ENDED; id++) list = unlessEnded(list, item(id, '2026-12-01T18:00:00Z'));
    expect(list.length).toBe(MOST_ENDED + 1);
    expect([list[0]?.id, list.at(-1)?.id]).toEqual([2 * MOST_ENDED, 0]);
  });
});

import { describe, expect, it } from 'vitest';
import type { CatalogueDetail } from '../../api/types';
import { CatalogueReading } from './reading.svelte';

/** Requests whose answers are given by the test, in any order. */
function byHand() {
  const answers = new Map<number, { give: (v: CatalogueDetail) => void; fail: (e: Error) => void }>();
  const catalogue = (id: number): Promise<CatalogueDetail> =>
    new Promise((give, fail) => answers.set(id, { give, fail }));
  return { reading: new CatalogueReading({ catalogue }), answers };
}
const detail = (id: number): CatalogueDetail => ({ id }) as CatalogueDetail;

describe('the catalogue on the star map', () => {
  it('does not show the error of a request for an earlier catalogue', async () => {
    const { reading, answers } = byHand();
    const [first, second] = [reading.read(1), reading.read(2)];
    answers.get(2)?.give(detail(2));
    await second;
    answers.get(1)?.fail(new Error('no such catalogue'));
    await first;
    expect([reading.detail?.id, reading.problem]).toEqual([2, '']);
  });
  it('shows the error of the present request, and removes it with the next one', async () => {
    const { reading, answers } = byHand();
    const first = reading.read(1);
    answers.get(1)?.fail(new Error('no such catalogue'));
    await first;
    expect(reading.problem).toContain('o such catalogue');
    void reading.read(2);
    expect([reading.detail, reading.problem]).toEqual([null, '']);
  });
  it('shows no catalogue if none is chosen while an answer is outstanding', async () => {
    const { reading, answers } = byHand();
    const first = reading.read(1);
    await reading.read(undefined);
    answers.get(1)?.give(detail(1));
    await first;
    expect(reading.detail).toBeNull();
  });
});

import { describe, expect, it } from 'vitest';
import type { ContactDetail, ContactRecord } from '../../api/types';
import { ContactReading } from './reading.svelte';

/** Answers are given by hand, in any order. */
function byHand() {
  const answers = new Map<string, { give: (v: unknown) => void; fail: (e: Error) => void }>();
  const ask =
    (kind: string) =>
    (id: number): Promise<never> =>
      new Promise((give, fail) =>
        answers.set(`${kind}${id}`, { give: give as (v: unknown) => void, fail: fail as (e: Error) => void }),
      );
  const reading = new ContactReading({ contact: ask('contact'), contactRecord: ask('record') });
  return { reading, answers };
}
const contact = (id: number): ContactDetail => ({ id }) as ContactDetail;
const record = (contact_id: number): ContactRecord => ({ contact_id }) as ContactRecord;

describe('the opened contact', () => {
  it('shows nothing of the contact opened before', async () => {
    const { reading, answers } = byHand();
    const first = [reading.readDetail(1), reading.readRecord(1)];
    answers.get('contact1')?.give(contact(1));
    answers.get('record1')?.give(record(1));
    await Promise.all(first);
    expect([reading.detail?.id, reading.record?.contact_id]).toEqual([1, 1]);
    void reading.readDetail(2);
    expect([reading.detail, reading.record]).toEqual([null, null]);
  });
  it('drops answers about it that come late, also failures', async () => {
    const { reading, answers } = byHand();
    const late = [reading.readDetail(1), reading.readRecord(1)];
    const next = [reading.readDetail(2), reading.readRecord(2)];
    answers.get('contact2')?.give(contact(2));
    answers.get('record2')?.give(record(2));
    await Promise.all(next);
    answers.get('contact1')?.give(contact(1));
    answers.get('record1')?.fail(new Error('the contact is gone'));
    await Promise.all(late);
    expect([reading.detail?.id, reading.record?.contact_id, reading.problem]).toEqual([2, 2, '']);
  });
  it('keeps a note just saved when an answer from before it comes late', async () => {
    const { reading, answers } = byHand();
    const before = reading.readDetail(1);
    reading.changed({ ...contact(1), note: 'clouds' });
    answers.get('contact1')?.give({ ...contact(1), note: '' });
    await before;
    expect(reading.detail?.note).toBe('clouds');
  });
});

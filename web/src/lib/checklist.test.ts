import { expect, it } from 'vitest';
import { checkWords, itemsOf, progressWords, sourceWords } from './checklist';

const AT = '2026-12-01T18:00:05.000Z';
const item = (done: boolean, at: string | null = AT) => ({
  ...{ text: 'a', done, user: at ? 'ann' : '', at, unchecked: done || !at ? '' : 'bob' },
});

it('states who checked an item and who removed the check', () => {
  expect(checkWords(item(true))).toBe('ann, 2026-12-01 18:00:05Z');
  expect(checkWords(item(false))).toBe('check of bob removed by ann, 2026-12-01 18:00:05Z');
  expect(checkWords(item(false, null))).toBe('');
  const checklist = { items: [], version: 3, user: '', changed: null, source: 'default' as const };
  const items = [item(true), item(false)];
  expect(progressWords({ items, checklist })).toBe('1 of 2 done, default items');
  expect(progressWords({ items: [], checklist: { ...checklist, version: 0 } })).toBe(
    '0 checked, the list of this contact is not stored',
  );
});
it('states where the items come from', () => {
  const list = { items: [], version: 0, user: '', changed: null };
  expect(sourceWords({ ...list, source: 'default' })).toBe('default items');
  expect(sourceWords({ ...list, source: 'instrument' })).toBe('items of the instrument package');
  expect(sourceWords({ ...list, source: 'user', user: 'bob', changed: AT })).toContain('changed by bob');
});
it('reads one item per line', () => {
  expect(itemsOf(' Dome  closed\n\n  Lens cap off \n')).toEqual(['Dome closed', 'Lens cap off']);
});

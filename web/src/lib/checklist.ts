/** Checklist of contacts as text. */
import type { Checklist, Handover } from '../api/types';
import { clock, day } from './format';

/**
 * Return how many items are done and where they come from: "3 of 7 done, default items". A contact of an earlier
 * version has no stored list; then only the checked items are known.
 */
export function progressWords({ items, checklist }: Pick<Handover, 'items' | 'checklist'>): string {
  const done = items.filter((i) => i.done).length;
  if (checklist.version === 0) return `${done} checked, the list of this contact is not stored`;
  return `${done} of ${items.length} done, ${sourceWords(checklist)}`;
}

/** Return where the items come from. */
export function sourceWords(list: Checklist): string {
  if (list.source === 'instrument') return 'items of the instrument package';
  if (list.source === 'default' || list.changed === null) return 'default items';
  return `items changed by ${list.user}, ${day(list.changed)} ${clock(list.changed)}`;
}

/** Return who checked an item, or removed the check, and when; empty if it was never checked. */
export function checkWords(item: Handover['items'][number]): string {
  if (item.at === null) return '';
  const who = `${item.user}, ${day(item.at)} ${clock(item.at)}`;
  return item.done ? who : `check of ${item.unchecked} removed by ${who}`;
}

/** Return the items of an edited text, one per line, without empty lines. */
export function itemsOf(text: string): string[] {
  return text
    .split('\n')
    .map((line) => line.trim().replace(/\s+/g, ' '))
    .filter(Boolean);
}

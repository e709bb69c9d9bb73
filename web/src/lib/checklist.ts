/** Checklist of contacts as text. */
import type { Checklist, Handover } from '../api/types';
import { clock, day } from './format';

/** Return how many items are done: "3 of 7 done". */
export function progressWords(items: Handover['items']): string {
  return `${items.filter((i) => i.done).length} of ${items.length} done`;
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

/** Lists of records, newest first, that are replaced and never changed in place. */

/** Maximum number of ended items in a list, so that it does not grow during a night. */
export const MOST_ENDED = 300;

/**
 * Insert or replace an item, unless it ended already: a response can arrive after the stream has reported the end.
 * `revives`: an ended item can start again, as a resumed transfer does.
 */
export function unlessEnded<R extends { id: number; finished: string | null; state: string }>(
  list: R[],
  item: R,
  revives = true,
): R[] {
  const before = list.find((x) => x.id === item.id);
  const stale =
    before !== undefined && before.finished !== null && item.finished === null && (!revives || item.state === 'queued');
  return stale ? list : upsert(list, item).filter((x, i) => i < MOST_ENDED || x.finished === null);
}

export function upsert<R extends { id: number }>(list: R[], item: R): R[] {
  const at = list.findIndex((x) => x.id === item.id);
  if (at < 0) return [item, ...list];
  return list.map((x, i) => (i === at ? item : x));
}

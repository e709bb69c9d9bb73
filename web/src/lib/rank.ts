/** Order of the palette's results: first by the quality of the match, then by the kind of the result. */
import { fuzzy, hasTypingError } from './fuzzy';

export interface Named {
  kind: string;
  text: string;
  note: string;
}

const ORDER = ['page', 'command', 'alarm', 'telemetry', 'help', 'bank', 'frame', 'contact', 'catalogue'];
/**
 * Score of each letter if all letters of the query are consecutive in the text. A lower score means that they are
 * scattered.
 */
const RUN = 5;

/**
 * Maximum length of a query for scattered matches. Almost every long text contains the letters of a longer query in
 * order.
 */
const MAX_SCATTERED_LENGTH = 5;

/**
 * Return the quality of a match. 2: consecutive letters or initials in the name. 1: consecutive letters or initials
 * in name, kind and note together. 0: scattered letters.
 */
function band(query: string, place: Named, fullScore: number): number {
  const consecutive = RUN * query.replace(/\s+/g, '').length;
  const strong = (score: number, text: string): boolean => score * (1 + text.length / 200) >= consecutive;
  if (strong(fuzzy(query, place.text), place.text)) return 2;
  return strong(fullScore, fullText(place)) ? 1 : 0;
}

const fullText = (p: Named): string => `${p.text} ${p.kind} ${p.note}`;
const kindOf = (p: Named): number => ORDER.indexOf(p.kind) + 1 || ORDER.length + 1;

/**
 * Return the best results for a query. If the letters of the query are consecutive in no result, names with one typing
 * error per word are returned, and scattered matches if there is no such name.
 */
export function rank<T extends Named>(query: string, places: readonly T[], limit: number): T[] {
  if (!query) return places.slice(0, limit);
  const hits = places
    .map((place, i) => ({ place, i, score: fuzzy(query, fullText(place)) }))
    .filter((h) => h.score > 0)
    .map((h) => ({ ...h, band: band(query, h.place, h.score) }));
  const best = Math.max(0, ...hits.map((h) => h.band));
  const similar = best === 0 ? places.filter((place) => hasTypingError(query, place.text)) : [];
  if (similar.length) return similar.sort((a, b) => kindOf(a) - kindOf(b)).slice(0, limit);
  return hits
    .filter((h) => h.band > 0 || (best === 0 && query.length <= MAX_SCATTERED_LENGTH))
    .sort((a, b) => b.band - a.band || kindOf(a.place) - kindOf(b.place) || b.score - a.score || a.i - b.i)
    .slice(0, limit)
    .map((h) => h.place);
}

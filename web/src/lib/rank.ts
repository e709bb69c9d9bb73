/** Order of the palette's results: by the quality of the match of the name, then by the kind of place. */
import { fuzzy } from './fuzzy';

export interface Named {
  kind: string;
  text: string;
  note: string;
}

const ORDER = ['page', 'command', 'alarm', 'telemetry', 'help', 'frame', 'contact', 'catalogue'];
/** Score of a letter found inside a word; a lower score means scattered letters. */
const RUN = 5;

/** The letters of a longer query are found in almost any long text, so scattered ones mean nothing. */
const SCATTERED_MOST = 5;

/** 2: the name starts with the query or has these initials. 1: the kind or the note does. 0: scattered letters. */
function band(query: string, place: Named, whole: number): number {
  const enough = RUN * query.replace(/\s+/g, '').length;
  const strong = (score: number, text: string): boolean => score * (1 + text.length / 200) >= enough;
  if (strong(fuzzy(query, place.text), place.text)) return 2;
  return strong(whole, words(place)) ? 1 : 0;
}

const words = (p: Named): string => `${p.text} ${p.kind} ${p.note}`;
const kindOf = (p: Named): number => ORDER.indexOf(p.kind) + 1 || ORDER.length + 1;

/** The best places for a query; scattered matches count only if there is no better match. */
export function rank<T extends Named>(query: string, places: readonly T[], most: number): T[] {
  if (!query) return places.slice(0, most);
  const hits = places
    .map((place, i) => ({ place, i, score: fuzzy(query, words(place)) }))
    .filter((h) => h.score > 0)
    .map((h) => ({ ...h, band: band(query, h.place, h.score) }));
  const best = Math.max(0, ...hits.map((h) => h.band));
  return hits
    .filter((h) => h.band > 0 || (best === 0 && query.length <= SCATTERED_MOST))
    .sort((a, b) => b.band - a.band || kindOf(a.place) - kindOf(b.place) || b.score - a.score || a.i - b.i)
    .slice(0, most)
    .map((h) => h.place);
}

/** Stars among the results of the palette. */
import type { FoundStar, StarSearchResult } from '../api/types';
import { degrees, fixed } from './format';
import type { Named } from './rank';

export interface StarHit extends Named {
  hip: number;
  exact: boolean;
}

/** Return the stars as results. A name that several stars have is shown with a designation: "δ Cep (27 Cep)". */
export function starHits(stars: readonly FoundStar[]): StarHit[] {
  return stars.map((star) => {
    const hit = starHit(star);
    const shared = stars.some((other) => other.hip !== star.hip && other.name === star.name);
    return shared ? { ...hit, text: `${star.name} (${star.other_names[0] ?? `HIP ${star.hip}`})` } : hit;
  });
}

function starHit(star: FoundStar): StarHit {
  const number = `HIP ${star.hip}`;
  const place = `V ${fixed(star.v_mag, 2)}, RA ${degrees(star.ra_deg, 2)}, Dec ${degrees(star.dec_deg, 2, true)}`;
  const names = star.name === number ? star.other_names : [...star.other_names, number];
  const note = [...names, place].join(', ');
  return { kind: 'star', text: star.name, note, hip: star.hip, exact: star.exact };
}

/**
 * Add stars to the other results: first the results whose name is the query, then stars with this name or number, then
 * the other results, then the other stars.
 */
export function withStars<T extends Named>(
  query: string,
  hits: readonly T[],
  stars: readonly (T & StarHit)[],
  limit: number,
): T[] {
  const name = query.toLowerCase();
  const [sameName, otherHits] = [
    hits.filter((h) => h.text.toLowerCase() === name),
    hits.filter((h) => h.text.toLowerCase() !== name),
  ];
  const [exact, other] = [stars.filter((s) => s.exact), stars.filter((s) => !s.exact)];
  const room = Math.max(0, limit - sameName.length - stars.length);
  return [...sameName, ...exact, ...otherHits.slice(0, room), ...other].slice(0, limit);
}

/** Return why a search has no star. */
export function noStarWords(query: string, result: StarSearchResult | null, problem: string): string {
  if (problem) return `The stars could not be searched: ${problem}`;
  if (!result) return 'Searching the star table …';
  const number = /^(?:hip\s*)?(\d{1,7})$/i.exec(query)?.[1];
  return number
    ? `HIP ${Number(number)} is not among the ${fixed(result.table_stars)} stars of the star table.`
    : `None of the ${fixed(result.named_stars)} named stars has this name or designation.`;
}

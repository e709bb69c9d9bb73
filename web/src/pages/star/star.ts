/** Facts of a star as text. */
import type { StarCard } from '../../api/types';
import { counted, degrees, fixed } from '../../lib/format';

const known = (value: number | null, digits: number, unit: string): string =>
  value === null ? 'unknown' : `${fixed(value, digits)} ${unit}`;

/** Return (name, value) of each fact. Values that the star table does not have are a dash. */
export function facts(s: StarCard): [string, string][] {
  return [
    ...(s.other_names.length ? [['Other names', s.other_names.join(', ')] as [string, string]] : []),
    ['Right ascension', degrees(s.ra_deg, 5)],
    ['Declination', degrees(s.dec_deg, 5, true)],
    ['V magnitude', fixed(s.v_mag, 2)],
    ['B−V', fixed(s.b_v, 3)],
    ['Proper motion', known(s.proper_motion_mas_yr, 1, 'mas/yr')],
    ['Parallax', known(s.parallax_mas, 2, 'mas')],
    ['Flags of the star table', s.flags.join(', ') || 'none'],
  ];
}

/** Return which catalogues were searched, and which of them could not be. */
export function catalogueWords(s: StarCard): string {
  if (!s.checked_catalogues) return 'No catalogue is stored.';
  const searched = s.checked_catalogues - s.unnumbered;
  const words = [`In ${fixed(s.catalogues.length)} of ${counted(searched, 'searched catalogue')}, newest first.`];
  if (s.unnumbered)
    words.push(`${counted(s.unnumbered, 'more catalogue has', 'more catalogues have')} no star numbers.`);
  if (s.unknown_banks.length)
    words.push(`The content of bank ${s.unknown_banks.join(', ')} is not stored, so the star is not searched there.`);
  return words.join(' ');
}

/** Return which frames were searched. */
export function frameWords(s: StarCard): string {
  if (!s.checked_frames) return 'No frame is solved.';
  const newest = counted(s.checked_frames, 'solved frame');
  return `Matched on the ground in ${fixed(s.frames.length)} of the newest ${newest}.`;
}

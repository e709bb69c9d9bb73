/** Facts of a star as text. */
import type { StarCard } from '../../api/types';
import { counted, degrees, fixed } from '../../lib/format';

/** Return (name, value) of each fact. Values that the star table does not have are a dash. */
export function facts(s: StarCard): [string, string][] {
  return [
    ...(s.other_names.length ? [['Other names', s.other_names.join(', ')] as [string, string]] : []),
    ['Right ascension', degrees(s.ra_deg, 5)],
    ['Declination', degrees(s.dec_deg, 5, true)],
    ['V magnitude', fixed(s.v_mag, 2)],
    ['B−V', fixed(s.b_v, 3)],
    ['Proper motion', `${fixed(s.proper_motion_mas_yr, 1)} mas/yr`],
    ['Parallax', `${fixed(s.parallax_mas, 2)} mas`],
    ['Properties', s.flags.join(', ') || 'none listed'],
  ];
}

/** Return which catalogues were searched, and which of them could not be. */
export function catalogueWords(s: StarCard): string {
  if (!s.checked_catalogues) return 'No catalogue is stored.';
  const searched = s.checked_catalogues - s.unnumbered;
  const words = [`${counted(searched, 'catalogue')} searched, newest first: found in ${fixed(s.catalogues.length)}.`];
  if (s.unnumbered)
    words.push(`${counted(s.unnumbered, 'more catalogue has', 'more catalogues have')} no star numbers.`);
  if (s.unknown_banks.length)
    words.push(`The content of bank ${s.unknown_banks.join(', ')} is not stored, so the star is not searched there.`);
  return words.join(' ');
}

/** Return which frames were searched. */
export function frameWords(s: StarCard): string {
  if (!s.checked_frames) return 'No frame is solved.';
  const searched = counted(s.checked_frames, 'solved frame');
  return `${searched} searched, newest first: matched on the ground in ${fixed(s.frames.length)}.`;
}

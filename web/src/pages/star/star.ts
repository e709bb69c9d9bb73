/** Text of the page of a star: its values, and which catalogues and frames were searched for it. */
import type { StarCard } from '../../api/types';
import { counted, degrees, fixed } from '../../lib/format';

const valueOrUnknown = (value: number | null, digits: number, unit = ''): string =>
  value === null ? 'unknown' : `${fixed(value, digits)} ${unit}`.trim();

/** Return (name, value) of each row of the table. A value that the star table does not contain is "unknown". */
export function starFacts(star: StarCard): [string, string][] {
  return [
    ...(star.other_names.length ? [['Other names', star.other_names.join(', ')] as [string, string]] : []),
    ['Right ascension', degrees(star.ra_deg, 5)],
    ['Declination', degrees(star.dec_deg, 5, true)],
    ['V magnitude', fixed(star.v_mag, 2)],
    ['B−V', valueOrUnknown(star.b_v, 3)],
    ['Proper motion', valueOrUnknown(star.proper_motion_mas_yr, 1, 'mas/yr')],
    ['Parallax', valueOrUnknown(star.parallax_mas, 2, 'mas')],
    ['Flags of the star table', star.flags.join(', ') || 'none'],
  ];
}

/** Return in how many catalogues the star is, and which catalogues and banks could not be searched for it. */
export function catalogueSummary(star: StarCard): string {
  if (!star.checked_catalogues) return 'No catalogue is stored.';
  const searched = star.checked_catalogues - star.unnumbered;
  const sentences = [
    `In ${fixed(star.catalogues.length)} of ${counted(searched, 'searched catalogue')}, newest first.`,
  ];
  if (star.unnumbered)
    sentences.push(`${counted(star.unnumbered, 'more catalogue has', 'more catalogues have')} no star numbers.`);
  if (star.unknown_banks.length)
    sentences.push(
      `The content of bank ${star.unknown_banks.join(', ')} is not stored, so the star is not searched there.`,
    );
  return sentences.join(' ');
}

/** Return in how many of the searched frames the star was matched. */
export function frameSummary(star: StarCard): string {
  if (!star.checked_frames) return 'No frame is solved.';
  const searched = counted(star.checked_frames, 'solved frame');
  return `Matched on the ground in ${fixed(star.frames.length)} of the newest ${searched}.`;
}

/** Number of stars of a catalogue as text. */
import type { CatalogueDetail } from '../../api/types';
import { counted, fixed } from '../../lib/format';

/** Return the number of stars of a catalogue and, if its map has only some of them, the number that is not drawn. */
export function starsText({ stars, sky }: Pick<CatalogueDetail, 'stars' | 'sky'>): string {
  const drawn = sky.filter((s) => s.state === 'kept').length;
  const missing = sky.length > 0 && drawn < stars ? `, ${fixed(stars - drawn)} not drawn` : '';
  return `${counted(stars, 'star')}${missing}`;
}

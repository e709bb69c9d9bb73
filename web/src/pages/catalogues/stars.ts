/** Number of stars of a catalogue as text. */
import type { CatalogueDetail } from '../../api/types';
import { counted, fixed } from '../../lib/format';

/** Return why the map of a catalogue has no stars. */
export function noStarsText({ stars, no_magnitude }: Pick<CatalogueDetail, 'stars' | 'no_magnitude'>): string {
  if (!stars) return 'This catalogue has no stars.';
  return no_magnitude > 0
    ? 'No star of this catalogue has a magnitude, so none is drawn.'
    : 'Star positions are not stored for this catalogue.';
}

/** Return the number of stars of a catalogue and, if its map has only some of them, the number that is not drawn. */
export function starsText({ stars, sky }: Pick<CatalogueDetail, 'stars' | 'sky'>): string {
  const drawn = sky.filter((s) => s.state === 'kept').length;
  const missing = sky.length > 0 && drawn < stars ? `, ${fixed(stars - drawn)} not drawn` : '';
  return `${counted(stars, 'star')}${missing}`;
}

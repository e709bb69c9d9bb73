/** Star that the address of a frame names, as in the link from the page of a star. */
import type { Star } from '../../api/types';

export class LinkedStar {
  private selected = '';

  /**
   * Return the index of the star to select. Null if the address names no star of the solution, or if this star was
   * selected before: a new solution does not change what the user has selected since.
   */
  select(frame: number, hip: number | null, stars: readonly Pick<Star, 'hip' | 'index'>[]): number | null {
    const star = hip === null ? undefined : stars.find((x) => x.hip === hip);
    const link = `${frame} ${hip}`;
    if (!star || link === this.selected) return null;
    this.selected = link;
    return star.index;
  }
}

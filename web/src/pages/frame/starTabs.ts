/** Tabs of the star table: each lists exactly the rows that it counts. */
import type { SolutionDetail, Star } from '../../api/types';

export type StarTab = 'matched' | 'unmatched' | 'rejected' | 'predicted';
export interface StarRows {
  /** Stars with a catalogue star, largest residual first. */
  matched: Star[];
  /** Detected stars without a catalogue star. */
  unmatched: Star[];
  rejected: SolutionDetail['regions'];
  predicted: SolutionDetail['predicted'];
}
export const NAMES: Record<StarTab, string> = {
  matched: 'Matched',
  unmatched: 'No match',
  rejected: 'Rejected',
  predicted: 'Predicted',
};
type Run = Pick<SolutionDetail, 'stars' | 'regions' | 'predicted'>;

/** Return the rows of each tab; no rows without a run. */
export function starRows(run: Run | null): StarRows {
  const stars = run?.stars ?? [];
  return {
    matched: stars.filter((x) => x.hip !== null).sort((a, b) => residual(b) - residual(a)),
    unmatched: stars.filter((x) => x.hip === null),
    rejected: (run?.regions ?? []).filter((r) => r.rejected),
    predicted: run?.predicted ?? [],
  };
}

/** Return the tab that lists the star with this index; null if no tab lists it. */
export function tabOf(rows: StarRows, index: number | null): 'matched' | 'unmatched' | null {
  if (rows.matched.some((x) => x.index === index)) return 'matched';
  return rows.unmatched.some((x) => x.index === index) ? 'unmatched' : null;
}

function residual(x: Star): number {
  return Math.hypot(x.dx_arcsec ?? 0, x.dy_arcsec ?? 0);
}

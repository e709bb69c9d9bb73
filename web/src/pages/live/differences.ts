/** Strip of the differences between on-board and ground attitude, oldest first. */
import type { Comparison, Difference } from '../../api/types';
import { fixed } from '../../lib/format';

export const MOST = 60;

export function withNewest(
  rows: readonly Difference[],
  id: number,
  taken: string,
  c: Comparison,
): readonly Difference[] {
  const row: Difference = { ...c, frame_id: id, taken };
  const same = rows.find((r) => r.frame_id === id);
  if (same && same.cross_arcsec === c.cross_arcsec) return rows;
  return [...rows.filter((r) => r.frame_id !== id), row].sort((a, b) => a.frame_id - b.frame_id).slice(-MOST);
}

export interface Bar {
  id: number;
  taken: string;
  arcsec: number;
  agree: boolean;
  x: number;
  y: number;
  width: number;
  height: number;
}

/** Return a bar for each frame. The largest difference has the full height. */
export function bars(rows: readonly Difference[], width: number, height: number): Bar[] {
  const max = Math.max(...rows.map((r) => r.cross_arcsec), 1e-9);
  const step = width / Math.max(rows.length, 10);
  return rows.map((r, i) => {
    const high = Math.max(1, (r.cross_arcsec / max) * (height - 2));
    const place = { x: i * step, y: height - high, width: Math.max(1, step - 1), height: high };
    return { id: r.frame_id, taken: r.taken, arcsec: r.cross_arcsec, agree: r.agree, ...place };
  });
}

/** Return a summary: "median 2.1″, maximum 6.4″, 60 frames". */
export function summary(rows: readonly Difference[]): string {
  const sorted = rows.map((r) => r.cross_arcsec).sort((a, b) => a - b);
  return `median ${fixed(sorted[sorted.length >> 1], 1)}″, maximum ${fixed(sorted.at(-1), 1)}″, ${rows.length} frames`;
}

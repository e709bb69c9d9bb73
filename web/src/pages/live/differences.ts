/** The strip of differences between the attitudes of sensor and ground, oldest first. */
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

/** One bar for each frame; the highest one fills the height. */
export function bars(rows: readonly Difference[], width: number, height: number): Bar[] {
  const most = Math.max(...rows.map((r) => r.cross_arcsec), 1e-9);
  const step = width / Math.max(rows.length, 10);
  return rows.map((r, i) => {
    const high = Math.max(1, (r.cross_arcsec / most) * (height - 2));
    const place = { x: i * step, y: height - high, width: Math.max(1, step - 1), height: high };
    return { id: r.frame_id, taken: r.taken, arcsec: r.cross_arcsec, agree: r.agree, ...place };
  });
}

/** "median 2.1″, most 6.4″ of 60 frames" */
export function summary(rows: readonly Difference[]): string {
  const sorted = rows.map((r) => r.cross_arcsec).sort((a, b) => a - b);
  return `median ${fixed(sorted[sorted.length >> 1], 1)}″, most ${fixed(sorted.at(-1), 1)}″ of ${rows.length} frames`;
}

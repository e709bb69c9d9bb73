/** Marks of detected and rejected regions: a box, and from zoom 4:1 the outline of the region's pixels. */
import type { Region, SolutionDetail } from '../../api/types';
import { outlineOf } from '../outline';
import { at, seen, type Ctx, type Scene, type Screen } from './screen';
import { PROMINENT } from './stars';

/** Zoom from which the pixels of a region are outlined. */
export const OUTLINE_FROM = 4;

/** Outline the pixels of the visible regions. Returns the number of outlined regions; 0 if the image is not loaded. */
function outlines(ctx: Ctx, s: Screen, scene: Scene, candidates: readonly Region[]): number {
  const image = scene.image;
  if (!image) return 0;
  const inView = candidates.filter(
    (r) => seen(s, ...at(s, r.col_max, r.row_max)) || seen(s, ...at(s, r.col_min, r.row_min)),
  );
  ctx.beginPath();
  for (const r of inView)
    for (const [x0, y0, x1, y1] of outlineOf(image, r)) {
      ctx.moveTo(...at(s, x0, y0));
      ctx.lineTo(...at(s, x1, y1));
    }
  ctx.stroke();
  return inView.length;
}

/** Draw the accepted regions. Returns the number of regions whose pixels were outlined. */
export function regions(
  ctx: Ctx,
  s: Screen,
  scene: Scene,
  sol: SolutionDetail,
  main: ReadonlySet<number>,
  ink: string,
): number {
  ctx.strokeStyle = ink;
  const accepted = sol.regions.filter((r) => !r.rejected);
  if (s.scale >= OUTLINE_FROM) {
    ctx.lineWidth = 1.2;
    return outlines(ctx, s, scene, accepted);
  }
  const shown = sol.stars.filter((star) => main.has(star.index));
  ctx.globalAlpha = 0.5;
  ctx.lineWidth = 1;
  for (const r of accepted) {
    if (
      sol.stars.length > PROMINENT &&
      !shown.some(
        (q) =>
          q.col_px > r.col_min - 1 && q.col_px < r.col_max + 1 && q.row_px > r.row_min - 1 && q.row_px < r.row_max + 1,
      )
    )
      continue;
    ctx.strokeRect(
      s.x + r.col_min * s.scale - 1.5,
      s.y + r.row_min * s.scale - 1.5,
      (r.col_max - r.col_min + 1) * s.scale + 3,
      (r.row_max - r.row_min + 1) * s.scale + 3,
    );
  }
  ctx.globalAlpha = 1;
  return 0;
}

export function rejected(ctx: Ctx, s: Screen, scene: Scene, sol: SolutionDetail, ink: string): void {
  ctx.strokeStyle = ink;
  const rejectedRegions = sol.regions.filter((q) => q.rejected);
  if (s.scale >= OUTLINE_FROM) {
    ctx.lineWidth = 1.2;
    outlines(ctx, s, scene, rejectedRegions);
  }
  for (const r of rejectedRegions) {
    const [cx, cy] = at(s, (r.col_min + r.col_max) / 2, (r.row_min + r.row_max) / 2);
    if (!seen(s, cx, cy)) continue;
    const half = Math.max(7, ((r.col_max - r.col_min + 1) * s.scale) / 2 + 2);
    ctx.setLineDash([2.5, 2.5]);
    ctx.lineWidth = 1;
    ctx.strokeRect(cx - half, cy - half, 2 * half, 2 * half);
    ctx.setLineDash([]);
    ctx.lineWidth = 1.3;
    ctx.beginPath();
    for (const [dx, dy] of [
      [-1, -1],
      [1, -1],
      [1, 1],
      [-1, 1],
    ] as const) {
      ctx.moveTo(cx + dx * half, cy + dy * (half - 4));
      ctx.lineTo(cx + dx * half, cy + dy * half);
      ctx.lineTo(cx + dx * (half - 4), cy + dy * half);
    }
    ctx.stroke();
  }
}

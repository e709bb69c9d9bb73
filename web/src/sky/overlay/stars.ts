/**
 * Stars: centroid, match, prediction, residual, selection. Marks keep their size at any zoom and do not cover the
 * star's core.
 */
import type { SolutionDetail } from '../../api/types';
import { at, seen, type Colour, type Ctx, type Scene, type Screen } from './screen';

const MATCH_RADIUS = 10;
/** Maximum number of visible stars with full marks. The others are dots until the user zooms in. */
export const PROMINENT = 40;

/**
 * Return the indices of the brightest visible stars. A deep solution names hundreds of stars, but an image has room for
 * only a few dozen marks.
 */
export function prominent(sol: SolutionDetail, s: Screen): ReadonlySet<number> {
  const inView = sol.stars.filter((star) => seen(s, ...at(s, star.col_px, star.row_px)));
  return new Set(
    inView
      .sort((a, b) => b.flux_dn - a.flux_dn)
      .slice(0, PROMINENT)
      .map((star) => star.index),
  );
}

export function predicted(ctx: Ctx, s: Screen, sol: SolutionDetail, ink: string): void {
  ctx.strokeStyle = ink;
  for (const p of sol.predicted) {
    const [x, y] = at(s, p.col_px, p.row_px);
    if (!seen(s, x, y)) continue;
    ctx.beginPath();
    if (p.detected)
      for (const [dx, dy] of [
        [1, 0],
        [-1, 0],
        [0, 1],
        [0, -1],
      ] as const) {
        ctx.moveTo(x + dx * 11.5, y + dy * 11.5);
        ctx.lineTo(x + dx * 15, y + dy * 15);
      }
    else {
      ctx.setLineDash([3, 2.5]);
      ctx.arc(x, y, 11, 0, 7);
    }
    ctx.stroke();
    ctx.setLineDash([]);
  }
}

/**
 * Return the flux from which an unmatched centroid has a diamond: the median flux of the matched stars. Fainter
 * centroids have only a plus.
 */
export function medianMatchedFlux(sol: SolutionDetail): number {
  const fluxes = sol.stars
    .filter((x) => x.hip !== null)
    .map((x) => x.flux_dn)
    .sort((a, b) => a - b);
  return fluxes[Math.floor(fluxes.length / 2)] ?? 0;
}

export function stars(ctx: Ctx, s: Screen, scene: Scene, main: ReadonlySet<number>, colour: Colour): void {
  const minFlux = scene.solution ? medianMatchedFlux(scene.solution) : 0;
  for (const star of scene.solution?.stars ?? []) {
    const [x, y] = at(s, star.col_px, star.row_px);
    if (!seen(s, x, y)) continue;
    if (!main.has(star.index) && scene.selected !== star.index) {
      if (star.hip !== null ? scene.show.matched : scene.show.centroids)
        dot(ctx, x, y, colour(star.hip !== null ? 'ov-match' : 'ov-region'));
      continue;
    }
    if (scene.show.centroids) plus(ctx, x, y, colour('ov-centroid'));
    if (star.hip !== null && scene.show.matched) ring(ctx, x, y, colour('ov-match'));
    if (star.hip === null && scene.show.matched && star.flux_dn >= minFlux) diamond(ctx, x, y, colour('ov-nomatch'));
    if (scene.show.residual && star.dx_px !== null && star.dy_px !== null)
      arrow(
        ctx,
        x,
        y,
        star.dx_px * scene.residualFactor,
        star.dy_px * scene.residualFactor,
        s.scale,
        colour('ov-centroid'),
      );
    if (scene.selected === star.index) box(ctx, x, y, colour('ac'));
  }
}

function dot(ctx: Ctx, x: number, y: number, ink: string): void {
  ctx.strokeStyle = ink;
  ctx.lineWidth = 1;
  ctx.globalAlpha = 0.42;
  ctx.beginPath();
  ctx.arc(x, y, 3.5, 0, 7);
  ctx.stroke();
  ctx.globalAlpha = 1;
}

function plus(ctx: Ctx, x: number, y: number, ink: string): void {
  ctx.strokeStyle = ink;
  ctx.lineWidth = 1;
  ctx.beginPath();
  for (const [dx, dy] of [
    [1, 0],
    [-1, 0],
    [0, 1],
    [0, -1],
  ] as const) {
    ctx.moveTo(x + dx * 2, y + dy * 2);
    ctx.lineTo(x + dx * 5, y + dy * 5);
  }
  ctx.stroke();
}

function ring(ctx: Ctx, x: number, y: number, ink: string): void {
  ctx.strokeStyle = ink;
  ctx.lineWidth = 1.3;
  ctx.beginPath();
  ctx.arc(x, y, MATCH_RADIUS, 0, 7);
  ctx.stroke();
}

function diamond(ctx: Ctx, x: number, y: number, ink: string): void {
  ctx.strokeStyle = ink;
  ctx.lineWidth = 1.3;
  ctx.beginPath();
  ctx.moveTo(x, y - 10);
  ctx.lineTo(x + 10, y);
  ctx.lineTo(x, y + 10);
  ctx.lineTo(x - 10, y);
  ctx.closePath();
  ctx.stroke();
}

function arrow(ctx: Ctx, x: number, y: number, dx: number, dy: number, scale: number, ink: string): void {
  ctx.strokeStyle = ink;
  ctx.fillStyle = ink;
  ctx.beginPath();
  ctx.moveTo(x, y);
  ctx.lineTo(x + dx * scale, y + dy * scale);
  ctx.stroke();
  ctx.beginPath();
  ctx.arc(x + dx * scale, y + dy * scale, 2, 0, 7);
  ctx.fill();
}

function box(ctx: Ctx, x: number, y: number, ink: string): void {
  ctx.strokeStyle = ink;
  ctx.lineWidth = 1.5;
  ctx.strokeRect(x - 13, y - 13, 26, 26);
}

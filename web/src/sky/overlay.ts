/**
 * Marks on the image: lines of 1–1.3 px that do not cover the star and keep their size at any zoom. overlay/ has a file
 * for each type of mark.
 */
import { boresight, compass, grid, scaleBar } from './overlay/grid';
import { missingRows } from './overlay/missing';
import { labels } from './overlay/names';
import { regions, rejected } from './overlay/regions';
import { picture, type Colour, type Ctx, type Scene, type Screen } from './overlay/screen';
import { predicted, prominent, stars } from './overlay/stars';

export type { Scene, Screen };

/** Draw the enabled overlays. Returns the number of regions whose pixels were outlined. */
export function drawOverlays(ctx: Ctx, s: Screen, scene: Scene, colour: Colour): number {
  missingRows(ctx, s, scene.frame, colour('unk'));
  const sol = scene.solution;
  if (!sol) return 0;
  ctx.lineWidth = 1.2;
  const photo = picture(s, scene.frame);
  const gridLabels = scene.show.grid ? grid(ctx, s, sol, photo, colour) : [];
  const main = prominent(sol, s);
  const outlined = scene.show.regions ? regions(ctx, s, scene, sol, main, colour('ov-region')) : 0;
  if (scene.show.rejected) rejected(ctx, s, scene, sol, colour('ov-rej'));
  if (scene.show.predicted) predicted(ctx, s, sol, colour('ov-pred'));
  stars(ctx, s, scene, main, colour);
  labels(ctx, s, scene, main, photo, gridLabels, colour);
  if (sol.north) compass(ctx, s, scene, colour);
  if (sol.attitude) boresight(ctx, s, sol, colour('ov-mag'));
  scaleBar(ctx, s, scene, colour);
  return outlined;
}

/** Celestial grid with degrees at the edge, compass with the roll, boresight and scale bar. */
import type { SolutionDetail } from '../../api/types';
import { fixed } from '../../lib/format';
import { overlaps, type Box } from '../labels';
import { at, corners, halo, plate, type Colour, type Ctx, type Scene, type Screen } from './screen';

/** Draw the grid. Returns the areas of its labels; a label that would overlap another is omitted. */
export function grid(ctx: Ctx, s: Screen, sol: SolutionDetail, photo: Box, colour: Colour): Box[] {
  const taken: Box[] = [];
  ctx.save();
  ctx.beginPath();
  ctx.rect(photo.x, photo.y, photo.w, photo.h);
  ctx.clip();
  ctx.strokeStyle = colour('ov-grid');
  ctx.lineWidth = 1;
  ctx.font = "11px 'IBM Plex Sans'";
  for (const line of sol.grid) {
    const pts = line.points.map(([c, r]) => at(s, c, r));
    ctx.globalAlpha = 0.34;
    ctx.beginPath();
    pts.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
    ctx.stroke();
    const [left, top, right, bottom] = [photo.x, photo.y, photo.x + photo.w, photo.y + photo.h];
    const inside = pts.filter(([x, y]) => x > left + 14 && x < right - 30 && y > top + 12 && y < bottom - 6);
    const end = [inside[0], inside[inside.length - 1]]
      .filter((p): p is [number, number] => p !== undefined)
      .sort((a, b) => Math.min(a[1] - top, bottom - a[1]) - Math.min(b[1] - top, bottom - b[1]))[0];
    if (!end || Math.min(end[1] - top, bottom - end[1]) > 26) continue;
    const y = end[1] < (top + bottom) / 2 ? top + 13 : bottom - 5;
    const place: Box = { x: end[0] + 1, y: y - 12, w: ctx.measureText(line.label).width + 6, h: 15, strict: true };
    if ([...taken, ...corners(s)].some((b) => overlaps(b, place))) continue;
    taken.push(place);
    ctx.globalAlpha = 0.95;
    halo(ctx, line.label, end[0] + 3, y, colour('tx3'), colour('ov-halo'));
  }
  ctx.restore();
  return taken;
}

export function compass(ctx: Ctx, s: Screen, scene: Scene, colour: Colour): void {
  const [dc, dr] = scene.solution?.north ?? [0, -1];
  const length = Math.hypot(dc, dr) || 1;
  const [nx, ny] = [dc / length, dr / length];
  const [ox, oy, arm] = [52, s.height - 66, 34];
  ctx.save();
  ctx.strokeStyle = colour('ov-txt');
  ctx.lineWidth = 1.2;
  ctx.font = "11.5px 'IBM Plex Sans'";
  for (const [label, x, y] of [
    ['N', nx, ny],
    ['E', ny, -nx],
  ] as const) {
    ctx.beginPath();
    ctx.moveTo(ox, oy);
    ctx.lineTo(ox + x * arm, oy + y * arm);
    ctx.stroke();
    halo(ctx, label, ox + x * (arm + 8) - 4, oy + y * (arm + 8) + 4, colour('ov-txt'), colour('ov-halo'));
  }
  ctx.strokeStyle = colour('ov-mag');
  ctx.setLineDash([1.5, 2.5]);
  ctx.beginPath();
  ctx.moveTo(ox, oy);
  ctx.lineTo(ox, oy - arm + 4);
  ctx.stroke();
  ctx.setLineDash([]);
  const angle = Math.atan2(ny, nx);
  ctx.beginPath();
  ctx.arc(ox, oy, 22, Math.min(-Math.PI / 2, angle), Math.max(-Math.PI / 2, angle));
  ctx.stroke();
  const roll = scene.solution?.attitude?.roll_deg;
  if (roll !== undefined) plate(ctx, `roll ${fixed(roll, 4)}°`, 14, s.height - 8, colour('ov-halo'));
  if (roll !== undefined) halo(ctx, `roll ${fixed(roll, 4)}°`, 14, s.height - 8, colour('ov-mag'), colour('ov-halo'));
  ctx.restore();
}

export function scaleBar(ctx: Ctx, s: Screen, scene: Scene, colour: Colour): void {
  const camera = scene.solution?.camera;
  if (!camera) return;
  const length = (deg: number): number => ((deg * Math.PI) / 180) * camera.focal_col_px * s.scale;
  const deg = [20, 10, 5, 2, 1, 0.5, 0.2, 0.1].find((d) => length(d) < s.width * 0.16) ?? 0.05;
  const [x1, x0, y] = [s.width - 16, s.width - 16 - length(deg), s.height - 12];
  ctx.save();
  ctx.strokeStyle = colour('ov-txt');
  ctx.lineWidth = 1.2;
  ctx.beginPath();
  for (const x of [x0, x1]) {
    ctx.moveTo(x, y - 5);
    ctx.lineTo(x, y);
  }
  ctx.moveTo(x0, y);
  ctx.lineTo(x1, y);
  ctx.stroke();
  ctx.font = "11.5px 'IBM Plex Sans'";
  ctx.textAlign = 'center';
  halo(ctx, `${deg}°`, (x0 + x1) / 2, y - 7, colour('ov-txt'), colour('ov-halo'));
  ctx.restore();
}

/** Draw the boresight: four lines around an open centre. */
export function boresight(ctx: Ctx, s: Screen, sol: SolutionDetail, ink: string): void {
  const [x, y] = at(s, sol.camera.centre_col_px, sol.camera.centre_row_px);
  ctx.strokeStyle = ink;
  ctx.lineWidth = 1;
  ctx.beginPath();
  for (const [dx, dy] of [
    [1, 0],
    [-1, 0],
    [0, 1],
    [0, -1],
  ] as const) {
    ctx.moveTo(x + dx * 8, y + dy * 8);
    ctx.lineTo(x + dx * 17, y + dy * 17);
  }
  ctx.stroke();
}

/** Marks over the image: 1–1.3 px strokes that leave the star free and keep their size at any zoom. */
import type { Frame, SolutionDetail } from '../api/types';
import { fixed } from '../lib/format';
import type { Overlay } from '../state/view.svelte';
import { overlaps, placeLabels, type Box, type Want } from './labels';

export interface Screen { scale: number; x: number; y: number; width: number; height: number }
export interface Scene { frame: Frame; solution: SolutionDetail | null; show: Record<Overlay, boolean>; selected: number | null; residualFactor: number }
type Ctx = CanvasRenderingContext2D;
const MATCH_RADIUS = 10;
/** How many stars in view get full marks; the others are dots until one zooms in. */
const PROMINENT = 40;

const at = (s: Screen, col: number, row: number): [number, number] => [s.x + (col + 0.5) * s.scale, s.y + (row + 0.5) * s.scale];
const seen = (s: Screen, x: number, y: number): boolean => x > -20 && y > -20 && x < s.width + 20 && y < s.height + 20;

export function drawOverlays(ctx: Ctx, s: Screen, scene: Scene, colour: (name: string) => string): void {
  missingRows(ctx, s, scene.frame, colour('unk'));
  const sol = scene.solution;
  if (!sol) return;
  ctx.lineWidth = 1.2;
  const photo = picture(s, scene.frame);
  const gridLabels = scene.show.grid ? grid(ctx, s, sol, photo, colour) : [];
  const main = prominent(sol, s);
  if (scene.show.regions) regions(ctx, s, sol, main, colour('ov-region'));
  if (scene.show.rejected) rejected(ctx, s, sol, colour('ov-rej'));
  if (scene.show.predicted) predicted(ctx, s, sol, colour('ov-pred'));
  stars(ctx, s, scene, main, colour);
  labels(ctx, s, scene, main, photo, gridLabels, colour);
  if (sol.north) compass(ctx, s, scene, colour);
  scaleBar(ctx, s, scene, colour);
}

function missingRows(ctx: Ctx, s: Screen, frame: Frame, colour: string): void {
  if (frame.complete) return;
  if (frame.held.length) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(s.x, s.y, frame.columns * s.scale, frame.rows * s.scale);
    for (const [col, row, columns, rows] of frame.held) ctx.rect(s.x + col * s.scale, s.y + row * s.scale, columns * s.scale, rows * s.scale);
    ctx.clip('evenodd');
    hatch(ctx, s.x, s.y, frame.columns * s.scale, frame.rows * s.scale, colour);
    ctx.restore();
    return;
  }
  let next = 0;
  const held = [...frame.rows_held].sort((a, b) => a[0] - b[0]);
  for (const [first, last] of [...held, [frame.rows, frame.rows] as [number, number]]) {
    if (first > next) hatch(ctx, s.x, s.y + next * s.scale, frame.columns * s.scale, (first - next) * s.scale, colour);
    next = Math.max(next, last + 1);
  }
}

export function hatch(ctx: Ctx, x: number, y: number, w: number, h: number, colour: string): void {
  ctx.save();
  ctx.beginPath();
  ctx.rect(x, y, w, h);
  ctx.clip();
  ctx.strokeStyle = colour;
  ctx.globalAlpha = 0.55;
  ctx.beginPath();
  for (let d = -h; d < w; d += 6) {
    ctx.moveTo(x + d, y + h);
    ctx.lineTo(x + d + h, y);
  }
  ctx.stroke();
  ctx.restore();
}

/** The part of the canvas that the image covers. */
function picture(s: Screen, frame: Frame): Box {
  const [x, y] = [Math.max(0, s.x), Math.max(0, s.y)];
  return { x, y, w: Math.min(s.width, s.x + frame.columns * s.scale) - x, h: Math.min(s.height, s.y + frame.rows * s.scale) - y };
}

/** Corners kept free: compass with the roll at the left, scale bar at the right. */
function corners(s: Screen): Box[] {
  return [{ x: 0, y: s.height - 114, w: 112, h: 114, strict: true }, { x: s.width * 0.82, y: s.height - 32, w: s.width * 0.18, h: 32, strict: true }];
}

/** Draws the grid and answers where its labels are; a label that would touch another is left out. */
function grid(ctx: Ctx, s: Screen, sol: SolutionDetail, photo: Box, colour: (n: string) => string): Box[] {
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
    const end = [inside[0], inside[inside.length - 1]].filter((p): p is [number, number] => p !== undefined).sort((a, b) => Math.min(a[1] - top, bottom - a[1]) - Math.min(b[1] - top, bottom - b[1]))[0];
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

function halo(ctx: Ctx, text: string, x: number, y: number, ink: string, ground: string): void {
  ctx.save();
  ctx.lineJoin = 'round';
  ctx.lineWidth = 3;
  ctx.strokeStyle = ground;
  ctx.strokeText(text, x, y);
  ctx.fillStyle = ink;
  ctx.fillText(text, x, y);
  ctx.restore();
}

/** A ground behind a line of text, so that marks under it do not run into its letters. */
function plate(ctx: Ctx, text: string, x: number, y: number, ground: string): void {
  ctx.save();
  ctx.globalAlpha = 0.82;
  ctx.fillStyle = ground;
  ctx.fillRect(x - 4, y - 12, ctx.measureText(text).width + 8, 16);
  ctx.restore();
}

/** The brightest stars that are in view, by index: a deep solution names hundreds, and a picture holds a few dozen marks. */
export function prominent(sol: SolutionDetail, s: Screen): ReadonlySet<number> {
  const inView = sol.stars.filter((star) => seen(s, ...at(s, star.col_px, star.row_px)));
  return new Set(inView.sort((a, b) => b.flux_dn - a.flux_dn).slice(0, PROMINENT).map((star) => star.index));
}

function regions(ctx: Ctx, s: Screen, sol: SolutionDetail, main: ReadonlySet<number>, ink: string): void {
  const shown = sol.stars.filter((star) => main.has(star.index));
  ctx.strokeStyle = ink;
  ctx.globalAlpha = 0.5;
  ctx.lineWidth = 1;
  for (const r of sol.regions) {
    if (r.rejected) continue;
    if (sol.stars.length > PROMINENT && !shown.some((q) => q.col_px > r.col_min - 1 && q.col_px < r.col_max + 1 && q.row_px > r.row_min - 1 && q.row_px < r.row_max + 1)) continue;
    ctx.strokeRect(s.x + r.col_min * s.scale - 1.5, s.y + r.row_min * s.scale - 1.5, (r.col_max - r.col_min + 1) * s.scale + 3, (r.row_max - r.row_min + 1) * s.scale + 3);
  }
  ctx.globalAlpha = 1;
}

function rejected(ctx: Ctx, s: Screen, sol: SolutionDetail, ink: string): void {
  ctx.strokeStyle = ink;
  for (const r of sol.regions.filter((q) => q.rejected)) {
    const [cx, cy] = at(s, (r.col_min + r.col_max) / 2, (r.row_min + r.row_max) / 2);
    if (!seen(s, cx, cy)) continue;
    const half = Math.max(7, ((r.col_max - r.col_min + 1) * s.scale) / 2 + 2);
    ctx.setLineDash([2.5, 2.5]);
    ctx.lineWidth = 1;
    ctx.strokeRect(cx - half, cy - half, 2 * half, 2 * half);
    ctx.setLineDash([]);
    ctx.lineWidth = 1.3;
    ctx.beginPath();
    for (const [dx, dy] of [[-1, -1], [1, -1], [1, 1], [-1, 1]] as const) {
      ctx.moveTo(cx + dx * half, cy + dy * (half - 4));
      ctx.lineTo(cx + dx * half, cy + dy * half);
      ctx.lineTo(cx + dx * (half - 4), cy + dy * half);
    }
    ctx.stroke();
  }
}

function predicted(ctx: Ctx, s: Screen, sol: SolutionDetail, ink: string): void {
  ctx.strokeStyle = ink;
  for (const p of sol.predicted) {
    const [x, y] = at(s, p.col_px, p.row_px);
    if (!seen(s, x, y)) continue;
    ctx.beginPath();
    if (p.detected) for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]] as const) {
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

/** Flux above which a centroid without a match deserves a mark: the median of the matched ones. Fainter ones keep their plus. */
function faintestMatched(sol: SolutionDetail): number {
  const fluxes = sol.stars.filter((x) => x.hip !== null).map((x) => x.flux_dn).sort((a, b) => a - b);
  return fluxes[Math.floor(fluxes.length / 2)] ?? 0;
}

function stars(ctx: Ctx, s: Screen, scene: Scene, main: ReadonlySet<number>, colour: (n: string) => string): void {
  const plain = scene.solution ? faintestMatched(scene.solution) : 0;
  for (const star of scene.solution?.stars ?? []) {
    const [x, y] = at(s, star.col_px, star.row_px);
    if (!seen(s, x, y)) continue;
    if (!main.has(star.index) && scene.selected !== star.index) {
      if (star.hip !== null ? scene.show.matched : scene.show.centroids) dot(ctx, x, y, colour(star.hip !== null ? 'ov-match' : 'ov-region'));
      continue;
    }
    if (scene.show.centroids) plus(ctx, x, y, colour('ov-centroid'));
    if (star.hip !== null && scene.show.matched) ring(ctx, x, y, colour('ov-match'));
    if (star.hip === null && scene.show.matched && star.flux_dn >= plain) diamond(ctx, x, y, colour('ov-nomatch'));
    if (scene.show.residual && star.dx_px !== null && star.dy_px !== null) arrow(ctx, x, y, star.dx_px * scene.residualFactor, star.dy_px * scene.residualFactor, s.scale, colour('ov-centroid'));
    if (scene.selected === star.index) box(ctx, x, y, colour('ac'));
  }
}

function dot(ctx: Ctx, x: number, y: number, ink: string): void {
  ctx.strokeStyle = ink;
  ctx.lineWidth = 1;
  ctx.globalAlpha = 0.75;
  ctx.beginPath();
  ctx.arc(x, y, 3.5, 0, 7);
  ctx.stroke();
  ctx.globalAlpha = 1;
}

function plus(ctx: Ctx, x: number, y: number, ink: string): void {
  ctx.strokeStyle = ink;
  ctx.lineWidth = 1;
  ctx.beginPath();
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]] as const) {
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

interface Text { parts: { text: string; ink: string }[][] }

function labels(ctx: Ctx, s: Screen, scene: Scene, main: ReadonlySet<number>, photo: Box, gridLabels: readonly Box[], colour: (n: string) => string): void {
  const { solution: sol, show } = scene;
  if (!sol) return;
  ctx.font = "11.5px 'IBM Plex Sans'";
  const texts = new Map<string, Text>();
  const wants: Want[] = [];
  const marks: Box[] = [...corners(s), ...gridLabels];
  const plain = faintestMatched(sol);
  const add = (key: string, col: number, row: number, rank: number, parts: Text['parts'], gap = 14): void => {
    const [x, y] = at(s, col, row);
    if (!seen(s, x, y)) return;
    const w = Math.max(...parts.map((line) => line.reduce((sum, p) => sum + ctx.measureText(p.text).width, 0)));
    texts.set(key, { parts });
    wants.push({ key, x, y, gap, w, h: 14 * parts.length, rank });
  };
  for (const star of sol.stars) {
    if (!main.has(star.index) && scene.selected !== star.index) continue;
    const [x, y] = at(s, star.col_px, star.row_px);
    if (star.hip !== null || star.flux_dn >= plain) marks.push({ x: x - 10, y: y - 10, w: 20, h: 20 });
    if (!show.matched) continue;
    if (star.hip === null) {
      if (star.flux_dn >= plain) add(`c${star.index}`, star.col_px, star.row_px, 6, [[{ text: 'no match', ink: colour('ov-nomatch') }]]);
    } else add(`s${star.index}`, star.col_px, star.row_px, star.v_mag ?? 5, [[{ text: `${star.name ?? `HIP ${star.hip}`} `, ink: colour('ov-txt') }, { text: fixed(star.v_mag, 2), ink: colour('ov-mag') }]]);
  }
  const missed = sol.predicted.filter((p) => !p.detected);
  for (const p of missed) {
    const region = show.rejected ? sol.regions.find((r) => r.rejected && p.col_px > r.col_min - 4 && p.col_px < r.col_max + 4 && p.row_px > r.row_min - 4 && p.row_px < r.row_max + 4) : undefined;
    const said = region && (p.v_mag < 1.5 || s.scale >= 2);
    const ink = said ? colour('ov-txt') : colour('ov-pred');
    const lines: Text['parts'] = [[{ text: `${p.name} `, ink }, { text: fixed(p.v_mag, 2), ink: colour('ov-mag') }]];
    if (said && region) lines.push([{ text: `rejected: ${region.rejected}`, ink: colour('ov-rej') }]);
    if (show.predicted || said) add(`p${p.hip}`, p.col_px, p.row_px, said ? -3 : p.v_mag + 2, lines, 15);
  }
  const area = { x: photo.x + 2, y: photo.y + 2, w: photo.w - 4, h: photo.h - 4 };
  for (const placed of placeLabels(wants, marks, area)) {
    texts.get(placed.key)?.parts.forEach((line, i) => {
      let x = placed.x;
      for (const part of line) {
        halo(ctx, part.text, x, placed.y + 11 + 14 * i, part.ink, colour('ov-halo'));
        x += ctx.measureText(part.text).width;
      }
    });
  }
}

function compass(ctx: Ctx, s: Screen, scene: Scene, colour: (n: string) => string): void {
  const [dc, dr] = scene.solution?.north ?? [0, -1];
  const length = Math.hypot(dc, dr) || 1;
  const [nx, ny] = [dc / length, dr / length];
  const [ox, oy, arm] = [52, s.height - 66, 34];
  ctx.save();
  ctx.strokeStyle = colour('ov-txt');
  ctx.lineWidth = 1.2;
  ctx.font = "11.5px 'IBM Plex Sans'";
  for (const [label, x, y] of [['N', nx, ny], ['E', ny, -nx]] as const) {
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

function scaleBar(ctx: Ctx, s: Screen, scene: Scene, colour: (n: string) => string): void {
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

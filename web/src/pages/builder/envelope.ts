/**
 * Drawing of a catalogue's map: time in field, borders at start and end of validity, fields along the path, and stars
 * by their state.
 */
import type { GeoProjection } from 'd3-geo';
import type { Envelope, Quality, SkyStar, Wanderer } from '../../api/types';
import { pixelAt } from './healpix';
import { overlaps, type Box, type Want } from '../../sky/labels';
import { pather } from '../../sky/mollweide';

type Colour = (name: string) => string;
type Line = readonly (readonly number[])[];
export interface Pen {
  ctx: CanvasRenderingContext2D;
  projection: GeoProjection;
  colour: Colour;
}
export interface Shade {
  nside: number;
  fraction: readonly number[];
}
/** Smallest distance of the labels of two hours. */
const HOUR_PX = 30;
const GHOSTS = 8;
const GHOST_STEP = 3;

function stroke(pen: Pen, line: Line, ink: string, width: number, dash: readonly number[] = [], alpha = 1): void {
  const { ctx } = pen;
  const first = line[0];
  if (!first) return;
  ctx.save();
  ctx.strokeStyle = pen.colour(ink);
  ctx.lineWidth = width;
  ctx.globalAlpha = alpha;
  ctx.setLineDash([...dash]);
  ctx.beginPath();
  pather(pen.projection, ctx)({ type: 'LineString', coordinates: [...line, first].map((p) => [p[0] ?? 0, p[1] ?? 0]) });
  ctx.stroke();
  ctx.restore();
}

/** Draw the border of the envelope: solid at the start of validity, dashed at its end. */
export function edges(pen: Pen, e: Envelope): void {
  for (const line of e.outline_start) stroke(pen, line, 'ac', 1.1);
  for (const line of e.outline_end) stroke(pen, line, 'ac', 1.1, [5, 4]);
}

/** Draw the field at a position of its path with a bold line; earlier positions are thin and fade. */
export function fields(pen: Pen, e: Envelope, at: number): void {
  const n = e.sweep.length;
  if (n === 0) return;
  for (let k = GHOSTS; k >= 1; k--) {
    const i = at - k * GHOST_STEP;
    if (i < 0 && e.sweep_over !== 'orbit') continue;
    stroke(pen, e.sweep[((i % n) + n) % n] ?? [], 'ac', 0.8, [], 0.5 * (1 - k / (GHOSTS + 1)));
  }
  const now = e.sweep[at] ?? [];
  stroke(pen, now, 'ac', 1.8);
  const place = e.boresights[at];
  const p = place && pen.projection([place[0], place[1]]);
  if (!p) return;
  const { ctx } = pen;
  ctx.strokeStyle = pen.colour('tx1');
  ctx.lineWidth = 1.3;
  ctx.beginPath();
  for (const [dx, dy] of [
    [6, 0],
    [0, 6],
  ] as const) {
    ctx.moveTo(p[0] - dx, p[1] - dy);
    ctx.lineTo(p[0] + dx, p[1] + dy);
  }
  ctx.stroke();
}

/** Return the label of the field. */
export function fieldLabel(pen: Pen, e: Envelope, at: number, text: string): Want | null {
  const place = e.boresights[at];
  const p = place && pen.projection([place[0], place[1]]);
  return p ? { key: text, x: p[0], y: p[1], gap: 9, w: pen.ctx.measureText(text).width + 2, h: 13, rank: 1 } : null;
}

/** Return an image of the time in the field in one hue. Each point has the value of its HEALPix pixel. */
export function shaded(
  e: Shade,
  peak: number,
  projection: GeoProjection,
  w: number,
  h: number,
  ink: string,
): OffscreenCanvas | null {
  const STEP = 2;
  const off = new OffscreenCanvas(Math.ceil(w / STEP), Math.ceil(h / STEP));
  const ctx = off.getContext('2d');
  if (!ctx) return null;
  const data = ctx.createImageData(off.width, off.height);
  const [r, g, b] = [1, 3, 5].map((i) => parseInt(ink.slice(i, i + 2), 16)) as [number, number, number];
  const flat = e.fraction.every((v) => v > peak * 0.5);
  const radius = Math.SQRT2 * projection.scale();
  for (let j = 0; j < off.height; j++)
    for (let i = 0; i < off.width; i++) {
      const [x, y] = [i * STEP + 1, j * STEP + 1];
      if (((x - w / 2) / (2 * radius)) ** 2 + ((y - h / 2) / radius) ** 2 > 1) continue;
      const at = projection.invert?.([x, y]);
      const f = at ? (e.fraction[pixelAt(e.nside, at[0], at[1])] ?? 0) : 0;
      if (f <= 0) continue;
      data.data.set([r, g, b, flat ? 46 : 22 + 165 * (f / peak)], 4 * (j * off.width + i));
    }
  ctx.putImageData(data, 0, 0);
  return off;
}

/** Draw the stars. Kept: solid. Thinned: hollow. Rejected: ×. Other stars: faint. */
export function stars(pen: Pen, list: readonly SkyStar[]): void {
  const { ctx, colour } = pen;
  for (const s of list) {
    const at = pen.projection([s.ra_deg, s.dec_deg]);
    if (!at) continue;
    const [x, y] = at;
    const r = Math.max(0.8, 3.2 - 0.5 * s.v_mag);
    ctx.beginPath();
    if (s.state === 'kept') {
      ctx.fillStyle = colour('tx1');
      ctx.arc(x, y, r, 0, 7);
      ctx.fill();
    } else if (s.state === 'thinned') {
      ctx.strokeStyle = colour('tx2');
      ctx.lineWidth = 1;
      ctx.arc(x, y, Math.max(1.6, r), 0, 7);
      ctx.stroke();
    } else if (s.state === 'rejected') {
      ctx.strokeStyle = colour('warn');
      ctx.lineWidth = 1.3;
      ctx.moveTo(x - 3, y - 3);
      ctx.lineTo(x + 3, y + 3);
      ctx.moveTo(x + 3, y - 3);
      ctx.lineTo(x - 3, y + 3);
      ctx.stroke();
    } else {
      ctx.fillStyle = colour('star');
      ctx.globalAlpha = 0.22;
      ctx.arc(x, y, Math.max(0.6, r * 0.6), 0, 7);
      ctx.fill();
      ctx.globalAlpha = 1;
    }
  }
}

/** Draw the path of the Sun, the Moon or a planet during the validity. Returns its label. */
export function wander(pen: Pen, p: Wanderer, rank: number): Want | null {
  const [first] = p.way;
  const at = first ? pen.projection([first[0], first[1]]) : null;
  if (!at) return null;
  const quick = p.name === 'Moon';
  const { ctx } = pen;
  ctx.save();
  ctx.strokeStyle = pen.colour('watch');
  ctx.lineWidth = quick ? 1 : 2;
  ctx.globalAlpha = quick ? 0.6 : 1;
  ctx.setLineDash(quick ? [1, 5] : []);
  ctx.beginPath();
  pather(pen.projection, ctx)({ type: 'LineString', coordinates: p.way.map((q) => [q[0], q[1]]) });
  ctx.stroke();
  ctx.restore();
  return { key: p.name, x: at[0], y: at[1], gap: 7, w: ctx.measureText(p.name).width + 2, h: 13, rank };
}

/** Draw the field with the fewest stars, dashed, or a square if an old record has no outline. Returns its label. */
export function worst(pen: Pen, q: Quality): Want | null {
  const at = pen.projection([q.worst_ra_deg, q.worst_dec_deg]);
  if (!at) return null;
  const { ctx } = pen;
  if (q.worst_outline.length) stroke(pen, q.worst_outline, 'watch', 1.4, [4, 3]);
  else {
    ctx.strokeStyle = pen.colour('watch');
    ctx.lineWidth = 1.4;
    ctx.setLineDash([4, 3]);
    ctx.strokeRect(at[0] - 11, at[1] - 11, 22, 22);
    ctx.setLineDash([]);
  }
  const text = `fewest stars: ${q.worst_stars}`;
  return { key: text, x: at[0], y: at[1], gap: 15, w: ctx.measureText(text).width + 2, h: 13, rank: 0 };
}

/** Draw the hours of right ascension that do not touch other labels, and the degrees of declination. */
export function axis(pen: Pen, taken: readonly Box[]): void {
  pen.ctx.font = "11px 'IBM Plex Sans'";
  const x = (hour: number): number => pen.projection([hour * 15, 0])?.[0] ?? 0;
  const step = x(10) - x(12) < HOUR_PX ? 4 : 2;
  for (let hour = step; hour < 24; hour += step) {
    const at = pen.projection([hour * 15, 0]);
    if (!at) continue;
    const box = { x: at[0] - 8, y: at[1] - 14, w: pen.ctx.measureText(`${hour}h`).width, h: 12 };
    if (!taken.some((b) => overlaps(b, box))) drawText(pen, `${hour}h`, box.x, at[1] - 4, 'tx3', 'chart');
  }
  for (const dec of [60, 30, -30, -60]) {
    const at = pen.projection([359.9, dec]);
    if (at) drawText(pen, `${dec > 0 ? '+' : '−'}${Math.abs(dec)}°`, at[0] - 28, at[1] + 4, 'tx3', 'bg1');
  }
}

export function drawText(pen: Pen, text: string, x: number, y: number, ink: string, back: string): void {
  const { ctx } = pen;
  ctx.lineWidth = 3;
  ctx.lineJoin = 'round';
  ctx.strokeStyle = pen.colour(back);
  ctx.strokeText(text, x, y);
  ctx.fillStyle = pen.colour(ink);
  ctx.fillText(text, x, y);
}

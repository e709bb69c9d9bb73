/** Drawing of the sky chart: stars by magnitude, constellation lines, field of view, trail and bodies. */
import {
  geoArea,
  geoCentroid,
  geoCircle,
  geoDistance,
  geoGraticule,
  geoOrthographic,
  type GeoProjection,
} from 'd3-geo';
import type { Figure, Sky } from '../api/types';
import { placeLabels, type Box, type Want } from './labels';
import { ecliptic, pather, skyProjection } from './mollweide';

export interface ChartScene {
  sky: Sky | null;
  field: readonly (readonly [number, number])[];
  boresight: { ra: number; dec: number } | null;
  trail: readonly (readonly [number, number])[];
  /** Constellations; empty if they are hidden. */
  figures: readonly Figure[];
  globe: boolean;
}
/** Maximum distance from the boresight at which a constellation is named. */
const NAMED_RAD = 0.3;
const FONT = "11.5px 'IBM Plex Sans'";
const LINE_PX = 14;
/** Order in which the names of bodies get a free position; planets come after them. */
const RANKS: Readonly<Record<string, number>> = { Sun: 1, Moon: 2, Earth: 3 };
type Colour = (name: string) => string;
type Body = Sky['bodies'][number];

export function chartProjection(scene: ChartScene, w: number, h: number): GeoProjection {
  if (!scene.globe) return skyProjection(w, h, 180, 6);
  const b = scene.boresight ?? { ra: 0, dec: 0 };
  return geoOrthographic()
    .rotate([-b.ra, -b.dec])
    .reflectX(true)
    .scale(Math.min(w, h) / 2 - 8)
    .translate([w / 2, h / 2])
    .clipAngle(90)
    .precision(0.3);
}

/** Return a closed ring, oriented so that d3 fills the smaller side; null for fewer than three points. */
export function ringOf(
  points: readonly (readonly [number, number])[],
): { type: 'Polygon'; coordinates: [number, number][][] } | null {
  if (points.length < 3) return null;
  const ring = points.map((p) => [p[0], p[1]] as [number, number]);
  const first = ring[0];
  if (first) ring.push(first);
  const shape = { type: 'Polygon' as const, coordinates: [ring] };
  if (geoArea(shape) > 2 * Math.PI) ring.reverse();
  return shape;
}

export function ground(ctx: CanvasRenderingContext2D, projection: GeoProjection, colour: Colour): void {
  const path = pather(projection, ctx);
  const stroke = (shape: Parameters<typeof path>[0], ink: string, dash: number[] = []): void => {
    ctx.beginPath();
    ctx.setLineDash(dash);
    ctx.strokeStyle = ink;
    path(shape);
    ctx.stroke();
    ctx.setLineDash([]);
  };
  ctx.lineWidth = 1;
  ctx.beginPath();
  path({ type: 'Sphere' });
  ctx.fillStyle = colour('chart');
  ctx.fill();
  stroke(geoGraticule().step([30, 30])(), colour('ln1'));
  stroke({ type: 'LineString', coordinates: Array.from({ length: 73 }, (_, i) => [i * 5, 0]) }, colour('ln2'));
  stroke({ type: 'LineString', coordinates: ecliptic() }, colour('edge'), [4, 3]);
  stroke({ type: 'Sphere' }, colour('ln2'));
}

export function drawChart(
  ctx: CanvasRenderingContext2D,
  w: number,
  h: number,
  scene: ChartScene,
  colour: Colour,
): void {
  const projection = chartProjection(scene, w, h);
  const path = pather(projection, ctx);
  ground(ctx, projection, colour);
  constellations(ctx, projection, scene, colour);
  dots(ctx, projection, scene, colour('star'));
  bodies(ctx, projection, scene, colour);
  if (scene.trail.length > 1) {
    ctx.setLineDash([2, 2.5]);
    ctx.strokeStyle = colour('ac');
    ctx.beginPath();
    path({ type: 'LineString', coordinates: scene.trail.map((p) => [p[0], p[1]]) });
    ctx.stroke();
    ctx.setLineDash([]);
  }
  const field = ringOf(scene.field);
  if (field) {
    ctx.beginPath();
    path(field);
    ctx.globalAlpha = 0.18;
    ctx.fillStyle = colour('ac');
    ctx.fill();
    ctx.globalAlpha = 1;
    ctx.strokeStyle = colour('ac');
    ctx.lineWidth = 1.3;
    ctx.stroke();
  }
  const b = scene.boresight;
  const p = b && visible(projection, scene, b.ra, b.dec);
  if (p) cross(ctx, p, colour('tx1'));
  names(ctx, projection, scene, colour, { x: 2, y: 2, w: w - 4, h: h - 4 });
}

/** Write the names of the boresight, the bodies and the constellations near the boresight, without overlap. */
function names(
  ctx: CanvasRenderingContext2D,
  projection: GeoProjection,
  scene: ChartScene,
  colour: Colour,
  area: Box,
): void {
  ctx.font = FONT;
  const inks = new Map<string, string>();
  const wants: Want[] = [];
  const marks: Box[] = [];
  const add = (name: string, ra: number, dec: number, size: number, rank: number, ink: string): void => {
    const p = visible(projection, scene, ra, dec);
    if (!p) return;
    inks.set(name, ink);
    wants.push({ key: name, x: p[0], y: p[1], gap: 8, w: ctx.measureText(name).width, h: LINE_PX, rank });
    if (size) marks.push({ x: p[0] - size / 2, y: p[1] - size / 2, w: size, h: size });
  };
  const b = scene.boresight;
  if (b) add('boresight', b.ra, b.dec, 12, 0, colour('tx2'));
  for (const { name, ra_deg, dec_deg } of scene.sky?.bodies ?? [])
    add(name, ra_deg, dec_deg, name === 'Earth' ? 0 : 8, RANKS[name] ?? 4, colour(name === 'Sun' ? 'watch' : 'tx2'));
  for (const f of b ? scene.figures : []) {
    const [ra, dec] = geoCentroid({ type: 'MultiPoint', coordinates: f.lines.flat() });
    if (b && geoDistance([ra, dec], [b.ra, b.dec]) <= NAMED_RAD) add(f.name, ra, dec, 0, 5, colour('tx3'));
  }
  for (const { key, x, y } of placeLabels(wants, marks, area))
    label(ctx, key, x, y + LINE_PX - 3, inks.get(key) ?? '', colour);
}

function visible(projection: GeoProjection, scene: ChartScene, ra: number, dec: number): [number, number] | null {
  if (scene.globe) {
    const b = scene.boresight ?? { ra: 0, dec: 0 };
    const k = Math.PI / 180;
    if (
      Math.sin(dec * k) * Math.sin(b.dec * k) + Math.cos(dec * k) * Math.cos(b.dec * k) * Math.cos((ra - b.ra) * k) <
      0
    )
      return null;
  }
  return projection([ra, dec]);
}

/** Draw the constellation lines, fainter than the stars. */
function constellations(
  ctx: CanvasRenderingContext2D,
  projection: GeoProjection,
  scene: ChartScene,
  colour: Colour,
): void {
  if (!scene.figures.length) return;
  ctx.globalAlpha = 0.3;
  ctx.strokeStyle = colour('star');
  ctx.lineWidth = 0.8;
  ctx.beginPath();
  pather(projection, ctx)({ type: 'MultiLineString', coordinates: scene.figures.flatMap((f) => f.lines) });
  ctx.stroke();
  ctx.globalAlpha = 1;
}

function dots(ctx: CanvasRenderingContext2D, projection: GeoProjection, scene: ChartScene, ink: string): void {
  ctx.fillStyle = ink;
  for (const s of scene.sky?.stars ?? []) {
    const p = visible(projection, scene, s.ra_deg, s.dec_deg);
    if (!p) continue;
    ctx.globalAlpha = s.v_mag < 2 ? 1 : s.v_mag < 3.5 ? 0.8 : 0.5;
    ctx.beginPath();
    ctx.arc(p[0], p[1], Math.max(0.45, 1.75 - 0.3 * s.v_mag), 0, 7);
    ctx.fill();
  }
  ctx.globalAlpha = 1;
}

/**
 * Draw the bodies and the circles of their exclusion angles, largest body first, because the Earth is the background of
 * the others.
 */
function bodies(ctx: CanvasRenderingContext2D, projection: GeoProjection, scene: ChartScene, colour: Colour): void {
  const path = pather(projection, ctx);
  const circle = (body: Body, radius: number): void => {
    ctx.beginPath();
    path(geoCircle().center([body.ra_deg, body.dec_deg]).radius(radius)());
  };
  const all = [...(scene.sky?.bodies ?? [])].sort((a, b) => b.radius_deg - a.radius_deg);
  for (const body of all) {
    const ink = body.name === 'Sun' ? colour('watch') : colour('tx3');
    if (body.radius_deg > 0) {
      circle(body, body.radius_deg);
      hatched(ctx, colour('ln2'), colour('tx3'));
    }
    ctx.setLineDash([4, 3]);
    ctx.strokeStyle = ink;
    circle(body, Math.min(179, body.radius_deg + body.exclusion_deg));
    ctx.stroke();
    ctx.setLineDash([]);
    const p = visible(projection, scene, body.ra_deg, body.dec_deg);
    if (p && body.name !== 'Earth') bodyMark(ctx, p, body.name, ink);
  }
}

/** Fill the current path with hatching and draw its edge. */
function hatched(ctx: CanvasRenderingContext2D, ink: string, edge: string): void {
  ctx.save();
  ctx.strokeStyle = edge;
  ctx.stroke();
  ctx.clip();
  const { width, height } = ctx.canvas;
  ctx.strokeStyle = ink;
  ctx.beginPath();
  for (let d = -height; d < width; d += 5) {
    ctx.moveTo(d, height);
    ctx.lineTo(d + height, 0);
  }
  ctx.stroke();
  ctx.restore();
}

function bodyMark(ctx: CanvasRenderingContext2D, [x, y]: [number, number], name: string, ink: string): void {
  ctx.fillStyle = ink;
  ctx.strokeStyle = ink;
  ctx.beginPath();
  ctx.arc(x, y, 4, 0, 7);
  if (name === 'Sun') ctx.fill();
  else {
    ctx.stroke();
    ctx.beginPath();
    ctx.arc(x, y, 4, Math.PI / 2, (3 * Math.PI) / 2);
    ctx.fill();
  }
}

function label(ctx: CanvasRenderingContext2D, text: string, x: number, y: number, ink: string, colour: Colour): void {
  ctx.font = FONT;
  ctx.lineWidth = 3;
  ctx.lineJoin = 'round';
  ctx.strokeStyle = colour('chart');
  ctx.strokeText(text, x, y);
  ctx.fillStyle = ink;
  ctx.fillText(text, x, y);
  ctx.lineWidth = 1;
}

function cross(ctx: CanvasRenderingContext2D, [x, y]: [number, number], ink: string): void {
  ctx.strokeStyle = ink;
  ctx.lineWidth = 1.3;
  ctx.beginPath();
  ctx.moveTo(x - 6, y);
  ctx.lineTo(x + 6, y);
  ctx.moveTo(x, y - 6);
  ctx.lineTo(x, y + 6);
  ctx.stroke();
}

/** Mollweide map of the whole sky with right ascension growing to the left. */
import { geoPath, geoProjection, type GeoProjection, type GeoRawProjection } from 'd3-geo';

const STEPS = 30;

/** Snyder 1987 eq. 31-1 to 31-3: θ from the latitude by Newton's method, then x and y. */
export function mollweideRaw(lambda: number, phi: number): [number, number] {
  let theta = phi;
  const target = Math.PI * Math.sin(phi);
  for (let i = 0; i < STEPS; i++) {
    const slope = 2 + 2 * Math.cos(2 * theta);
    if (Math.abs(slope) < 1e-12) break;
    const step = (2 * theta + Math.sin(2 * theta) - target) / slope;
    theta -= step;
    if (Math.abs(step) < 1e-12) break;
  }
  return [((2 * Math.SQRT2) / Math.PI) * lambda * Math.cos(theta), Math.SQRT2 * Math.sin(theta)];
}

function invert(x: number, y: number): [number, number] {
  const theta = Math.asin(Math.max(-1, Math.min(1, y / Math.SQRT2)));
  const phi = Math.asin((2 * theta + Math.sin(2 * theta)) / Math.PI);
  return [(Math.PI * x) / (2 * Math.SQRT2 * Math.cos(theta)), phi];
}

const raw: GeoRawProjection = Object.assign(mollweideRaw, { invert });

/** Return a d3 projection of [ra, dec] in degrees, centred at `centreRa`, that fills a box except for a margin. */
export function skyProjection(width: number, height: number, centreRa = 180, margin = 6): GeoProjection {
  const scale = Math.min((width - 2 * margin) / (4 * Math.SQRT2), (height - 2 * margin) / (2 * Math.SQRT2));
  return geoProjection(raw)
    .rotate([-centreRa, 0])
    .reflectX(true)
    .scale(scale)
    .translate([width / 2, height / 2])
    .precision(0.2);
}

export function pather(
  projection: GeoProjection,
  ctx: CanvasRenderingContext2D,
): (shape: Parameters<ReturnType<typeof geoPath>>[0]) => void {
  const path = geoPath(projection, ctx);
  return (shape) => path(shape);
}

/** Return the ecliptic as [ra, dec] in degrees, for an obliquity of 23.4393° (J2000). */
export function ecliptic(): [number, number][] {
  const e = (23.4393 * Math.PI) / 180;
  return Array.from({ length: 181 }, (_, i) => {
    const l = (i * 2 * Math.PI) / 180;
    const ra = (Math.atan2(Math.sin(l) * Math.cos(e), Math.cos(l)) * 180) / Math.PI;
    return [ra, (Math.asin(Math.sin(l) * Math.sin(e)) * 180) / Math.PI];
  });
}

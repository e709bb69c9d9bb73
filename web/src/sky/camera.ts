/**
 * Compute the direction of a pixel from a solution's camera model and quaternion. For display only; the server computes
 * all results.
 */
export type Vec = readonly [number, number, number];
export type Matrix = readonly [Vec, Vec, Vec];
const RAD = Math.PI / 180;

/** Return the matrix cam_from_icrs of a scalar-last quaternion. */
export function matrixOf(q: readonly number[]): Matrix {
  const [x = 0, y = 0, z = 0, w = 1] = q;
  const n = 2 / (x * x + y * y + z * z + w * w);
  return [
    [1 - n * (y * y + z * z), n * (x * y - z * w), n * (x * z + y * w)],
    [n * (x * y + z * w), 1 - n * (x * x + z * z), n * (y * z - x * w)],
    [n * (x * z - y * w), n * (y * z + x * w), 1 - n * (x * x + y * y)],
  ];
}

export function apply(m: Matrix, v: Vec): Vec {
  return [dot(m[0], v), dot(m[1], v), dot(m[2], v)];
}

export function applyTransposed(m: Matrix, v: Vec): Vec {
  return [0, 1, 2].map((i) => (m[0][i] ?? 0) * v[0] + (m[1][i] ?? 0) * v[1] + (m[2][i] ?? 0) * v[2]) as unknown as Vec;
}

function dot(a: Vec, b: Vec): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

export function unit(raDeg: number, decDeg: number): Vec {
  const c = Math.cos(decDeg * RAD);
  return [c * Math.cos(raDeg * RAD), c * Math.sin(raDeg * RAD), Math.sin(decDeg * RAD)];
}

export function raDec(v: Vec): { ra: number; dec: number } {
  const ra = Math.atan2(v[1], v[0]) / RAD;
  return { ra: ra < 0 ? ra + 360 : ra, dec: Math.asin(v[2] / Math.hypot(...v)) / RAD };
}

export function separationDeg(a: Vec, b: Vec): number {
  const cross = Math.hypot(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]);
  return Math.atan2(cross, dot(a, b)) / RAD;
}

/** Camera model of a result, as the server sends it. Pixel centres at integer (col, row). */
export interface Camera {
  columns: number;
  rows: number;
  focal_col_px: number;
  focal_row_px: number;
  centre_col_px: number;
  centre_row_px: number;
  distortion: Record<string, unknown>;
}
type Point = readonly [number, number];
const STEPS = 40;

const numberOf = (d: Record<string, unknown>, name: string): number => (typeof d[name] === 'number' ? d[name] : 0);

/** Brown–Conrady polynomial on the tangent plane. */
function brown(d: Record<string, unknown>, [x, y]: Point): [number, number] {
  const [k1, k2, k3, p1, p2] = ['k1', 'k2', 'k3', 'p1', 'p2'].map((n) => numberOf(d, n)) as [
    number,
    number,
    number,
    number,
    number,
  ];
  const r2 = x * x + y * y;
  const radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
  return [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y];
}

function unBrown(d: Record<string, unknown>, measured: Point): [number, number] {
  let [x, y] = measured;
  for (let i = 0; i < STEPS; i++) {
    const [u, v] = brown(d, [x, y]);
    const [ex, ey] = [measured[0] - u, measured[1] - v];
    x += ex;
    y += ey;
    if (Math.hypot(ex, ey) < 1e-13) break;
  }
  return [x, y];
}

/** Tilted detector and radial polynomial (Jacobs 1995 eq. 6.13–6.16), measured to ideal. */
function unRadialTilt(d: Record<string, unknown>, [x, y]: Point): [number, number] {
  const focal = numberOf(d, 'focal_mm') || 1;
  const radial = Array.isArray(d['radial']) ? (d['radial'] as number[]) : [];
  const r = Math.hypot(x, y);
  if (r === 0) return [x, y];
  const tilt = Math.asin(
    Math.sin(numberOf(d, 'tilt_max_rad')) * Math.cos(Math.atan2(y, x) - numberOf(d, 'tilt_direction_rad')),
  );
  const delta = radial.reduce((sum, k, i) => sum + k * (r * focal) ** (i + 1), 0) / focal;
  const scale = (Math.cos(tilt) * (r - delta)) / (1 + r * Math.sin(tilt)) / r;
  return [x * scale, y * scale];
}

/**
 * Convert a tangent-plane point from measured to ideal; null for a distortion model that this page does not support.
 */
export function undistort(d: Record<string, unknown>, p: Point): [number, number] | null {
  switch (d['model']) {
    case 'Pinhole':
      return [p[0], p[1]];
    case 'Brown':
      return unBrown(d, p);
    case 'BrownUndistort':
      return brown(d, p);
    case 'RadialTilt':
      return unRadialTilt(d, p);
    default:
      return null;
  }
}

/**
 * Return the ICRS direction of a pixel in degrees. `exact` is false if the distortion model is not supported here, or
 * if the attitude is corrected for aberration (null: it is not), which the direction still contains.
 */
export function pixelToSky(
  camera: Camera,
  q: readonly number[],
  col: number,
  row: number,
  aberrationArcsec: number | null = null,
): { ra: number; dec: number; exact: boolean } {
  const measured: Point = [
    (col - camera.centre_col_px) / camera.focal_col_px,
    (row - camera.centre_row_px) / camera.focal_row_px,
  ];
  const ideal = undistort(camera.distortion, measured);
  const [x, y] = ideal ?? measured;
  return { ...raDec(applyTransposed(matrixOf(q), [x, y, 1])), exact: ideal !== null && aberrationArcsec === null };
}

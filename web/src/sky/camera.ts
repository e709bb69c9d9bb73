/** Pinhole geometry for read-outs: pixels ↔ ICRS through the solution's quaternion. Without the distortion it is approximate. */
export type Vec = readonly [number, number, number];
export type Matrix = readonly [Vec, Vec, Vec];
const RAD = Math.PI / 180;

/** cam_from_icrs of a scalar-last quaternion. */
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

export interface Pinhole { columns: number; rows: number; focalPx: number }

export function pinhole(columns: number, rows: number, fovDeg: readonly number[] | null | undefined): Pinhole | null {
  const width = fovDeg?.[0];
  return width ? { columns, rows, focalPx: columns / 2 / Math.tan((width / 2) * RAD) } : null;
}

export function pixelToSky(camera: Pinhole, q: readonly number[], col: number, row: number): { ra: number; dec: number } {
  const v: Vec = [(col - (camera.columns - 1) / 2) / camera.focalPx, (row - (camera.rows - 1) / 2) / camera.focalPx, 1];
  return raDec(applyTransposed(matrixOf(q), v));
}

export function skyToPixel(camera: Pinhole, q: readonly number[], ra: number, dec: number): { col: number; row: number } | null {
  const [x, y, z] = apply(matrixOf(q), unit(ra, dec));
  if (z <= 0) return null;
  return { col: (camera.columns - 1) / 2 + (camera.focalPx * x) / z, row: (camera.rows - 1) / 2 + (camera.focalPx * y) / z };
}

/** Attitude from a sensor's telemetry. The instrument package declares order and direction of the quaternion. */
import { apply, applyTransposed, matrixOf, raDec } from './camera';

/** Return the Hamilton product of two scalar-last quaternions. */
function product(a: readonly number[], b: readonly number[]): number[] {
  const [ax = 0, ay = 0, az = 0, aw = 0] = a;
  const [bx = 0, by = 0, bz = 0, bw = 0] = b;
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

/**
 * Return the quaternion cam_from_icrs. `camFromSensor`: rotation from the sensor frame to the camera frame. Both are
 * scalar-last.
 */
export function camFromIcrs(
  components: readonly number[],
  order: string,
  rotation: string,
  camFromSensor: readonly number[],
): number[] {
  const [a = 0, b = 0, c = 0, d = 0] = components;
  const [x, y, z, w] = order === 'scalar_first' ? [b, c, d, a] : [a, b, c, d];
  return product(camFromSensor, rotation === 'cam_from_icrs' ? [x, y, z, w] : [-x, -y, -z, w]);
}

/**
 * Return right ascension and declination of the boresight and the roll in degrees (docs/icd.md, clause 5.11); null for
 * a quaternion of length zero.
 */
export function boresight(quaternion: readonly number[]): { ra: number; dec: number; roll: number } | null {
  if (!quaternion.some((q) => q !== 0)) return null;
  const matrix = matrixOf(quaternion);
  const [east, south] = apply(matrix, [0, 0, 1]);
  const roll = (Math.atan2(-east, -south) * 180) / Math.PI;
  return { ...raDec(applyTransposed(matrix, [0, 0, 1])), roll: roll < 0 ? roll + 360 : roll };
}

/** Return the angle between two attitudes in degrees; NaN if a quaternion has length zero. */
export function rotationBetween(a: readonly number[], b: readonly number[]): number {
  const cosine = Math.abs(a.reduce((sum, q, k) => sum + q * (b[k] ?? 0), 0));
  const norm = Math.hypot(...a) * Math.hypot(...b);
  return norm === 0 ? NaN : (2 * Math.acos(Math.min(1, cosine / norm)) * 180) / Math.PI;
}

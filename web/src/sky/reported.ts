/** Attitude in a sensor's telemetry: order and direction of its quaternion as its package declares them. */
import { apply, applyTransposed, matrixOf, raDec } from './camera';

/** The quaternion cam_from_icrs, scalar-last. */
export function camFromIcrs(components: readonly number[], order: string, rotation: string): number[] {
  const [a = 0, b = 0, c = 0, d = 0] = components;
  const [x, y, z, w] = order === 'scalar_first' ? [b, c, d, a] : [a, b, c, d];
  return rotation === 'cam_from_icrs' ? [x, y, z, w] : [-x, -y, -z, w];
}

/**
 * Right ascension and declination of the boresight and roll in degrees (docs/icd.md, clause 5.11); null for a
 * quaternion of length zero.
 */
export function boresight(quaternion: readonly number[]): { ra: number; dec: number; roll: number } | null {
  if (!quaternion.some((q) => q !== 0)) return null;
  const matrix = matrixOf(quaternion);
  const [east, south] = apply(matrix, [0, 0, 1]);
  const roll = (Math.atan2(-east, -south) * 180) / Math.PI;
  return { ...raDec(applyTransposed(matrix, [0, 0, 1])), roll: roll < 0 ? roll + 360 : roll };
}

/** Angle of the rotation between two attitudes, degrees. Both quaternions are unit quaternions. */
export function rotationBetween(a: readonly number[], b: readonly number[]): number {
  const cosine = Math.abs(a.reduce((sum, q, k) => sum + q * (b[k] ?? 0), 0));
  const norm = Math.hypot(...a) * Math.hypot(...b);
  return norm === 0 ? NaN : (2 * Math.acos(Math.min(1, cosine / norm)) * 180) / Math.PI;
}

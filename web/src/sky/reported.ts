/** Attitude in a sensor's telemetry: order and direction of its quaternion as its package declares them. */
import { applyTransposed, matrixOf, raDec } from './camera';

/** The quaternion cam_from_icrs, scalar-last. */
export function camFromIcrs(components: readonly number[], order: string, rotation: string): number[] {
  const [a = 0, b = 0, c = 0, d = 0] = components;
  const [x, y, z, w] = order === 'scalar_first' ? [b, c, d, a] : [a, b, c, d];
  return rotation === 'cam_from_icrs' ? [x, y, z, w] : [-x, -y, -z, w];
}

/** Right ascension and declination of the boresight in degrees; null for a quaternion of length zero. */
export function boresight(quaternion: readonly number[]): { ra: number; dec: number } | null {
  if (!quaternion.some((q) => q !== 0)) return null;
  return raDec(applyTransposed(matrixOf(quaternion), [0, 0, 1]));
}

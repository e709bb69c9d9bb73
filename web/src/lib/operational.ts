/** Which solution is a frame's operational ground result, and how it is described. */
import type { Frame, Solution } from '../api/types';

/** "reference chain, camera cubestar": how the shown ground result was computed. */
export function madeWith(
  of: Pick<Frame, 'chain' | 'camera_name'> | Pick<Solution, 'chain' | 'camera_name'> | null | undefined,
): string {
  if (!of?.chain) return '';
  const name = of.camera_name;
  const camera =
    name === 'blind'
      ? 'solved blind'
      : name === 'field of view'
        ? 'field of view entered'
        : name
          ? `camera ${name}`
          : 'camera not recorded';
  return `${of.chain} chain, ${camera}`;
}

/**
 * True if the solution may become the operational ground result: computed on the ground, and not a rerun of the
 * sensor's chain.
 */
export function canPin(s: Pick<Solution, 'origin' | 'replay' | 'operational'>): boolean {
  return s.origin === 'ground' && s.replay === null && !s.operational;
}

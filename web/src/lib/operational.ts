/** Description of a frame's operational ground result, and the rule for choosing another one. */
import type { Frame, Solution } from '../api/types';

/** Return how a ground result was computed: "reference chain, camera cubestar". */
export function chainAndCamera(
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

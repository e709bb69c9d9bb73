/**
 * The four steps of the chain and the image that each result belongs to, so that no result is shown for another image.
 */
import type { Command } from '../../api/types';

export const CHAIN = ['TAKE_IMAGE', 'FIND_CENTROIDS', 'MATCH_STARS', 'CALCULATE_ATTITUDE'] as const;
const WHOLE = ['RUN_ITERATION', 'START_CYCLE', 'STOP_CYCLE'];

/**
 * ``own``: the step's own command. ``within``: done by an iteration or the cycle. ``older``: its newest result belongs
 * to an image or a step that has been replaced since. ``none``: not in this contact.
 */
export type StepResult =
  | { by: 'own'; command: Command }
  | { by: 'iteration' | 'cycle'; command: Command }
  | { by: 'older'; command: Command }
  | { by: 'none' };

/** The newest command with one of those names in that contact (commands are numbered in the order of creation). */
function newest(
  commands: readonly Command[],
  contact: number | null,
  names: readonly string[],
  done: boolean,
): Command | undefined {
  let found: Command | undefined;
  for (const c of commands) {
    if (c.contact_id !== contact || !names.includes(c.name) || (done && c.result !== 'completed')) continue;
    if (!found || c.id > found.id) found = c;
  }
  return found;
}

/**
 * The display of a step: results of another contact, or from before the newest image or the newest previous step, are
 * not current.
 */
export function stepResult(step: string, commands: readonly Command[], contact: number | null): StepResult {
  const own = newest(commands, contact, [step], false);
  const at = CHAIN.findIndex((n) => n === step);
  const whole = at < 0 ? undefined : newest(commands, contact, WHOLE, true);
  const before = newest(commands, contact, CHAIN.slice(0, Math.max(0, at)), true);
  const latest = whole && (!own || whole.id > own.id) ? whole : own;
  if (!latest) return { by: 'none' };
  if (before && before.id > latest.id) return { by: 'older', command: latest };
  if (latest === own) return { by: 'own', command: latest };
  return { by: latest.name === 'RUN_ITERATION' ? 'iteration' : 'cycle', command: latest };
}

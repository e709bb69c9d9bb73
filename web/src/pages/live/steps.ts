/** The four steps of the chain. A result is shown only for the image to which it belongs. */
import type { Command } from '../../api/types';

export const CHAIN = ['TAKE_IMAGE', 'FIND_CENTROIDS', 'MATCH_STARS', 'CALCULATE_ATTITUDE'] as const;
const ALL_STEPS = ['RUN_ITERATION', 'START_CYCLE', 'STOP_CYCLE'];

/**
 * Source of a step's result. `own`: the command of this step. `iteration`, `cycle`: a command that runs all steps.
 * `older`: the latest result belongs to an earlier image or to an earlier result of a preceding step. `none`: no result
 * in this contact.
 */
export type StepResult =
  | { by: 'own'; command: Command }
  | { by: 'iteration' | 'cycle'; command: Command }
  | { by: 'older'; command: Command }
  | { by: 'none' };

/** Return the latest command with one of the names in a contact. Ids increase in the order of creation. */
function latestOf(
  commands: readonly Command[],
  contact: number | null,
  names: readonly string[],
  done: boolean,
): Command | undefined {
  let latest: Command | undefined;
  for (const c of commands) {
    if (c.contact_id !== contact || !names.includes(c.name) || (done && c.result !== 'completed')) continue;
    if (!latest || c.id > latest.id) latest = c;
  }
  return latest;
}

/**
 * Return the result of a step. Results of another contact are ignored; results older than the latest image or the
 * latest result of a preceding step are marked as older.
 */
export function stepResult(step: string, commands: readonly Command[], contact: number | null): StepResult {
  const own = latestOf(commands, contact, [step], false);
  const at = CHAIN.findIndex((n) => n === step);
  const combined = at < 0 ? undefined : latestOf(commands, contact, ALL_STEPS, true);
  const before = latestOf(commands, contact, CHAIN.slice(0, Math.max(0, at)), true);
  const latest = combined && (!own || combined.id > own.id) ? combined : own;
  if (!latest) return { by: 'none' };
  if (before && before.id > latest.id) return { by: 'older', command: latest };
  if (latest === own) return { by: 'own', command: latest };
  return { by: latest.name === 'RUN_ITERATION' ? 'iteration' : 'cycle', command: latest };
}

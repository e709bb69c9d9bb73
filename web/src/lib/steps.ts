/** The four steps of the chain: whose result each of them shows, so that none stands on an image it was not made of. */
import type { Command } from '../api/types';

export const CHAIN = ['TAKE_IMAGE', 'FIND_CENTROIDS', 'MATCH_STARS', 'CALCULATE_ATTITUDE'] as const;
const WHOLE = ['RUN_ITERATION', 'START_CYCLE', 'STOP_CYCLE'];

/** ``own``: the step's own command. ``within``: it was done in an iteration or in the cycle, by that command. ``older``: its
 *  newest result is of an image or a step that has been replaced since. ``none``: not in this contact. */
export type Told =
  | { by: 'own'; command: Command }
  | { by: 'iteration' | 'cycle'; command: Command }
  | { by: 'older'; command: Command }
  | { by: 'none' };

/** The newest command (they are numbered as they were made) of those names in that contact. */
function newest(commands: readonly Command[], contact: number | null, names: readonly string[], done: boolean): Command | undefined {
  let found: Command | undefined;
  for (const c of commands) {
    if (c.contact_id !== contact || !names.includes(c.name) || (done && c.result !== 'completed')) continue;
    if (!found || c.id > found.id) found = c;
  }
  return found;
}

/** What a step shows: results of another contact, or made before the newest image or the newest step before it, say nothing now. */
export function told(step: string, commands: readonly Command[], contact: number | null): Told {
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

/** A form that asks the server for one thing: busy while it waits, then done, or the problem stands in the form. */
import type { Problem } from '../api/types';
import { problemOf } from '../lib/problems';

export class Asking {
  busy = $state(false);
  problem = $state<Problem | null>(null);

  async run(ask: () => Promise<unknown>): Promise<boolean> {
    this.busy = true;
    this.problem = null;
    try {
      await ask();
    } catch (error) {
      this.problem = problemOf(error);
    }
    this.busy = false;
    return this.problem === null;
  }
}

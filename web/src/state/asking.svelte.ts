/** A form with one request to the server: busy while it waits, then done, or its problem is shown in the form. */
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

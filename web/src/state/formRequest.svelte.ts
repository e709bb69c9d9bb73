/** The request of a form: `busy` while it is in progress, `problem` after a failure. */
import type { Problem } from '../api/types';
import { problemOf } from '../lib/problems';

export class FormRequest {
  busy = $state(false);
  problem = $state<Problem | null>(null);

  /** Send the request. Returns true if it succeeded. */
  async run(send: () => Promise<unknown>): Promise<boolean> {
    this.busy = true;
    this.problem = null;
    try {
      await send();
    } catch (error) {
      this.problem = problemOf(error);
    }
    this.busy = false;
    return this.problem === null;
  }
}

/** Stack runs: the remaining steps of a failed run, and whether it can be continued. */
import type { StackIn, StackRun } from '../../api/types';

type Step = StackIn['steps'][number];

/** Return the remaining steps in the format of a stack. `skip`: without the present step. */
export function stepsLeft(run: Pick<StackRun, 'steps' | 'step'>, skip: boolean): Step[] {
  return run.steps
    .slice(run.step + Number(skip))
    .map(
      ({ command, arguments: values, delay_s, condition, note }) =>
        ({ command, arguments: values, delay_s, condition, note }) as Step,
    );
}

/**
 * True if the run can be continued: it is the latest run and ended at a failed step. A run that was stopped by a user
 * or by ABORT must start from the beginning.
 */
export function canContinue(run: Pick<StackRun, 'id' | 'state'> | null, all: readonly Pick<StackRun, 'id'>[]): boolean {
  return run !== null && run.state === 'failed' && all.every((r) => r.id <= run.id);
}

/** Runs of stacks: the remaining steps of a failed run, and whether it can be resumed. */
import type { StackIn, StackRun } from '../../api/types';

type Step = StackIn['steps'][number];

/** The remaining steps, in the format of a stack. */
export function stepsLeft(run: Pick<StackRun, 'steps' | 'step'>, skip: boolean): Step[] {
  return run.steps
    .slice(run.step + Number(skip))
    .map(
      ({ command, arguments: values, delay_s, condition, note }) =>
        ({ command, arguments: values, delay_s, condition, note }) as Step,
    );
}

/** Only the newest run, and only if a step failed: a run stopped by a user or ABORT starts from the beginning. */
export function mayGoOn(run: Pick<StackRun, 'id' | 'state'> | null, all: readonly Pick<StackRun, 'id'>[]): boolean {
  return run !== null && run.state === 'failed' && all.every((r) => r.id <= run.id);
}

/** Runs of stacks: what is left of one that ended at a step, and whether it may be taken up again. */
import type { StackIn, StackRun } from '../api/types';

type Step = StackIn['steps'][number];

/** The steps that are still to be sent, as a stack has them. */
export function stepsLeft(run: Pick<StackRun, 'steps' | 'step'>, skip: boolean): Step[] {
  return run.steps.slice(run.step + Number(skip)).map(({ command, arguments: values, delay_s, condition, note }) => ({ command, arguments: values, delay_s, condition, note }) as Step);
}

/** Only the newest run, and only where a step failed: what was stopped by a person or ABORT begins anew. */
export function mayGoOn(run: Pick<StackRun, 'id' | 'state'> | null, all: readonly Pick<StackRun, 'id'>[]): boolean {
  return run !== null && run.state === 'failed' && all.every((r) => r.id <= run.id);
}

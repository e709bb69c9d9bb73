import { describe, expect, it } from 'vitest';
import type { StackRun } from '../../api/types';
import { canContinue, stepsLeft } from './runs';

const step = (command: string, state: string): StackRun['steps'][number] => ({
  command,
  arguments: { n: 1 },
  delay_s: 2,
  condition: null,
  note: '',
  state,
  command_id: 7,
  detail: 'x',
});
const RUN = { step: 1, steps: [step('A', 'completed'), step('B', 'failed'), step('C', 'waiting')] };

describe('a run that failed', () => {
  it('leaves the failed step and those after it, without their results', () => {
    expect(stepsLeft(RUN, false)).toEqual([
      { command: 'B', arguments: { n: 1 }, delay_s: 2, condition: null, note: '' },
      { command: 'C', arguments: { n: 1 }, delay_s: 2, condition: null, note: '' },
    ]);
    expect(stepsLeft(RUN, true).map((s) => s.command)).toEqual(['C']);
  });
  it('can be resumed while it is the newest', () => {
    expect(canContinue({ id: 3, state: 'failed' }, [{ id: 3 }, { id: 2 }])).toBe(true);
    expect(canContinue({ id: 2, state: 'failed' }, [{ id: 3 }, { id: 2 }])).toBe(false);
  });
  it('is not resumed if a user stopped it', () => {
    expect(canContinue({ id: 3, state: 'stopped' }, [{ id: 3 }])).toBe(false);
    expect(canContinue(null, [])).toBe(false);
  });
});

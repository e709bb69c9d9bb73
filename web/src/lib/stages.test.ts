import { describe, expect, it } from 'vitest';
import type { Command } from '../api/types';
import { isUnsettled, mergeCommands, retained, retryProblem, waitingOutside } from './stages';

const command = (id: number, result = 'completed', resolved_note = ''): Command =>
  ({ id, result, resolved_note }) as Command;

describe('commands of unknown outcome', () => {
  it('are not sent again to another unit', () => {
    expect(retryProblem({ can_retry: true })).toBe('');
    expect(retryProblem({ can_retry: false })).toContain('not on the line');
  });
  it('wait until an operator says what was found', () => {
    expect([command(1, 'unknown'), command(2, 'unknown', 'seen on board'), command(3)].map(isUnsettled)).toEqual([
      true,
      false,
      false,
    ]);
  });
  it('stay in the list however old they are', () => {
    const list = mergeCommands([command(9), command(8)], [command(2, 'unknown'), command(9)]);
    expect(list.map((c) => c.id)).toEqual([9, 8, 2]);
    expect(retained(list, 1).map((c) => c.id)).toEqual([9, 2]);
  });
  it('are listed outside the period of the history, so that the mark of the sidebar has its command', () => {
    const old = command(2, 'unknown');
    const list = [command(9), command(8, 'unknown'), command(3), old, command(1, 'unknown', 'seen on board')];
    const none = { text: '', user: '', result: '' };
    expect(waitingOutside(list, list.slice(0, 2), none)).toEqual([old]);
    expect(waitingOutside(list, list, none)).toEqual([]);
    expect(waitingOutside(list, [], { ...none, result: 'unknown' }).map((c) => c.id)).toEqual([8, 2]);
    for (const other of [{ result: 'failed' }, { text: 'SET' }, { user: 'ann' }])
      expect(waitingOutside(list, [], { ...none, ...other })).toEqual([]);
  });
});

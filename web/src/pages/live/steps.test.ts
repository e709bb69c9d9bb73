import { describe, expect, it } from 'vitest';
import type { Command } from '../../api/types';
import { stepResult } from './steps';

let id = 0;
const done = (name: string, over: Partial<Command> = {}): Command =>
  ({ id: ++id, contact_id: 1, name, result: 'completed', ...over }) as Command;
const chain = (): Command[] =>
  ['TAKE_IMAGE', 'FIND_CENTROIDS', 'MATCH_STARS', 'CALCULATE_ATTITUDE'].map((n) => done(n));

describe('steps of the chain', () => {
  it('shows the result of each step while all belong to one image', () => {
    const list = chain();
    expect(list.map((c) => stepResult(c.name, list, 1))).toEqual(list.map((command) => ({ by: 'own', command })));
  });
  it('clears the later steps when a new image is taken', () => {
    const list = [...chain(), done('TAKE_IMAGE')];
    expect(
      ['TAKE_IMAGE', 'FIND_CENTROIDS', 'MATCH_STARS', 'CALCULATE_ATTITUDE'].map((n) => stepResult(n, list, 1).by),
    ).toEqual(['own', 'older', 'older', 'older']);
    list.push(done('FIND_CENTROIDS'));
    expect(['FIND_CENTROIDS', 'MATCH_STARS'].map((n) => stepResult(n, list, 1).by)).toEqual(['own', 'older']);
  });
  it('keeps the results if the new image was refused', () => {
    const list = [...chain(), done('TAKE_IMAGE', { result: 'rejected' })];
    expect([stepResult('TAKE_IMAGE', list, 1).by, stepResult('MATCH_STARS', list, 1).by]).toEqual(['own', 'own']);
  });
  it('shows that an iteration or the cycle did the step since then', () => {
    expect(stepResult('MATCH_STARS', [...chain(), done('RUN_ITERATION')], 1).by).toBe('iteration');
    const cycled = [...chain(), done('START_CYCLE'), done('STOP_CYCLE')];
    expect([stepResult('TAKE_IMAGE', cycled, 1).by, stepResult('MATCH_STARS', cycled, 1).by]).toEqual([
      'cycle',
      'cycle',
    ]);
    expect(stepResult('MATCH_STARS', [...cycled, done('TAKE_IMAGE')], 1).by).toBe('older');
  });
  it('shows nothing of another contact', () => {
    expect(stepResult('TAKE_IMAGE', chain(), 2)).toEqual({ by: 'none' });
  });
});

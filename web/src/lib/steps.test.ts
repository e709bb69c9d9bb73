import { describe, expect, it } from 'vitest';
import type { Command } from '../api/types';
import { told } from './steps';

let id = 0;
const done = (name: string, over: Partial<Command> = {}): Command => ({ id: ++id, contact_id: 1, name, result: 'completed', ...over }) as Command;
const chain = (): Command[] => ['TAKE_IMAGE', 'FIND_CENTROIDS', 'MATCH_STARS', 'CALCULATE_ATTITUDE'].map((n) => done(n));

describe('steps of the chain', () => {
  it('shows what each step gave while all belong to one image', () => {
    const list = chain();
    expect(list.map((c) => told(c.name, list, 1))).toEqual(list.map((command) => ({ by: 'own', command })));
  });
  it('takes the later steps back when a new image is taken', () => {
    const list = [...chain(), done('TAKE_IMAGE')];
    expect(['TAKE_IMAGE', 'FIND_CENTROIDS', 'MATCH_STARS', 'CALCULATE_ATTITUDE'].map((n) => told(n, list, 1).by)).toEqual(['own', 'older', 'older', 'older']);
    list.push(done('FIND_CENTROIDS'));
    expect(['FIND_CENTROIDS', 'MATCH_STARS'].map((n) => told(n, list, 1).by)).toEqual(['own', 'older']);
  });
  it('keeps the results when the new image was refused', () => {
    const list = [...chain(), done('TAKE_IMAGE', { result: 'rejected' })];
    expect([told('TAKE_IMAGE', list, 1).by, told('MATCH_STARS', list, 1).by]).toEqual(['own', 'own']);
  });
  it('knows that an iteration or the cycle did the step since', () => {
    expect(told('MATCH_STARS', [...chain(), done('RUN_ITERATION')], 1).by).toBe('iteration');
    const cycled = [...chain(), done('START_CYCLE'), done('STOP_CYCLE')];
    expect([told('TAKE_IMAGE', cycled, 1).by, told('MATCH_STARS', cycled, 1).by]).toEqual(['cycle', 'cycle']);
    expect(told('MATCH_STARS', [...cycled, done('TAKE_IMAGE')], 1).by).toBe('older');
  });
  it('says nothing of another contact', () => {
    expect(told('TAKE_IMAGE', chain(), 2)).toEqual({ by: 'none' });
  });
});

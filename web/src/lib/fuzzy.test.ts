import { describe, expect, it } from 'vitest';
import { best, fuzzy } from './fuzzy';

const NAMES = ['SET_EXPOSURE', 'SET_FRAME_RATE', 'START_CYCLE', 'STOP_CYCLE', 'GET_STATUS', 'TAKE_IMAGE', 'ACTIVATE_BANK'];
const first = (q: string): string | undefined => best(q, NAMES, (n) => n, 5)[0];

describe('finding by a few letters', () => {
  it('takes the initials of words', () => {
    expect(first('se')).toBe('SET_EXPOSURE');
    expect(first('ti')).toBe('TAKE_IMAGE');
    expect(first('sfr')).toBe('SET_FRAME_RATE');
  });
  it('puts a whole part of the name before scattered letters', () => {
    expect(first('bank')).toBe('ACTIVATE_BANK');
    expect(first('stop')).toBe('STOP_CYCLE');
  });
  it('wants every letter in its order and every word', () => {
    expect(fuzzy('xq', 'SET_EXPOSURE')).toBe(0);
    expect(fuzzy('bank zebra', 'ACTIVATE_BANK')).toBe(0);
  });
  it('fits everything when nothing is asked', () => {
    expect(best('', NAMES, (n) => n, 3)).toEqual(NAMES.slice(0, 3));
  });
});

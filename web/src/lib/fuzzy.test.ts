import { describe, expect, it } from 'vitest';
import { best, fuzzy } from './fuzzy';

const NAMES = [
  'SET_EXPOSURE',
  'SET_FRAME_RATE',
  'START_CYCLE',
  'STOP_CYCLE',
  'GET_STATUS',
  'TAKE_IMAGE',
  'ACTIVATE_BANK',
];
const first = (q: string): string | undefined => best(q, NAMES, (n) => n, 5)[0];

describe('fuzzy search', () => {
  it('matches the initials of words', () => {
    expect(first('se')).toBe('SET_EXPOSURE');
    expect(first('ti')).toBe('TAKE_IMAGE');
    expect(first('sfr')).toBe('SET_FRAME_RATE');
  });
  it('ranks consecutive letters above scattered letters', () => {
    expect(first('bank')).toBe('ACTIVATE_BANK');
    expect(first('stop')).toBe('STOP_CYCLE');
  });
  it('requires every word and every letter in order', () => {
    expect(fuzzy('xq', 'SET_EXPOSURE')).toBe(0);
    expect(fuzzy('bank zebra', 'ACTIVATE_BANK')).toBe(0);
  });
  it('matches everything for an empty query', () => {
    expect(best('', NAMES, (n) => n, 3)).toEqual(NAMES.slice(0, 3));
  });
});

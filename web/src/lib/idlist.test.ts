import { describe, expect, it } from 'vitest';
import { idsOf, parseIds, writeIds } from './idlist';

describe('lists of frame numbers', () => {
  it('are parsed as written', () => {
    expect(parseIds('3-5, 9 4')).toEqual([3, 4, 5, 9]);
    expect(parseIds('')).toEqual([]);
    expect(() => parseIds('a')).toThrow('not a number');
    expect(() => parseIds('9-3')).toThrow('not a range');
  });
  it('are part of a link, and a broken link names none', () => {
    expect(idsOf('3-5,9')).toEqual([3, 4, 5, 9]);
    expect(idsOf('all of them')).toEqual([]);
  });
  it('are written in short form and parsed back', () => {
    expect(writeIds([5, 3, 4, 9])).toBe('3-5, 9');
    expect(parseIds(writeIds([1, 2, 3, 7]))).toEqual([1, 2, 3, 7]);
  });
});

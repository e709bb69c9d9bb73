import { expect, test } from 'vitest';
import { bound, range, rangeText } from './derived';

test('a bound is a number, nothing, or wrong', () => {
  expect(bound(' 2.5 ')).toBe(2.5);
  expect(bound('−3')).toBe(-3);
  expect(bound('')).toBeNull();
  expect(bound('4 V')).toBeUndefined();
});

test('a range is wrong if one of its bounds is', () => {
  expect(range('', '5')).toEqual([null, 5]);
  expect(range('x', '5')).toBeUndefined();
});

test('a range is shown with its open sides', () => {
  expect(rangeText([null, null])).toBe('–');
  expect(rangeText([1, null])).toBe('1 …');
  expect(rangeText([-2, 3])).toBe('-2 … 3');
});

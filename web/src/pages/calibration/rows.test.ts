import { expect, test } from 'vitest';
import { parseRows } from './rows';

test("rows of numbers are parsed from a spreadsheet's text", () => {
  expect(parseRows('col,row\n1.5,2\r\n-3\t4e1\n\n 5 ; 6 ', 2)).toEqual([
    [1.5, 2],
    [-3, 40],
    [5, 6],
  ]);
});

test('a true minus is a minus', () => {
  expect(parseRows('\u221220, 0.8\n\u221210, \u22122.1', 2)).toEqual([
    [-20, 0.8],
    [-10, -2.1],
  ]);
});

test('a row of another length or with a word is reported with its line', () => {
  expect(() => parseRows('1,2\n3', 2)).toThrow('line 2 is not 2 numbers: 3');
  expect(() => parseRows('1,x', 2)).toThrow('line 1');
});

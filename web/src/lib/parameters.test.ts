import { describe, expect, it } from 'vitest';
import { parametersIn } from './parameters';

describe('parametersIn', () => {
  const known = new Set(['housekeeping.supply_3v3_v', 'housekeeping.current_ma', 'solution.matched']);
  it('returns each known parameter once, in the order of the text', () => {
    const text = '(housekeeping.current_ma + housekeeping.current_ma) * housekeeping.supply_3v3_v > 0.5';
    expect(parametersIn(text, known)).toEqual(['housekeeping.current_ma', 'housekeeping.supply_3v3_v']);
  });
  it('leaves out numbers, functions and names that the sensor does not have', () => {
    expect(parametersIn('sqrt(12.5) + other.field, housekeeping.unknown', known)).toEqual([]);
  });
});

import { expect, test } from 'vitest';
import type { FieldDefinition } from '../../api/types';
import { bound, examples, range, rangeText } from './derived';

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
  expect(rangeText([1, null])).toBe('≥ 1');
  expect(rangeText([null, 7])).toBe('≤ 7');
  expect(rangeText([-2, 3])).toBe('-2 … 3');
});

test('examples use telemetry of the sensor with matching units', () => {
  const field = (name: string, unit: string, page = 'health'): FieldDefinition =>
    ({ name, unit, page, packet: 'hk', title: name }) as FieldDefinition;
  const [supply, current] = [field('supply_v', 'V'), field('board_ma', 'mA')];
  expect(examples([field('twice_v', 'V', 'derived'), supply, current]).map((e) => e.expression)).toEqual([
    'hk.supply_v * hk.board_ma',
  ]);
  expect(examples([supply, field('lens_c', '°C')])).toEqual([]);
  expect(examples([field('lens_c', '°C'), field('board_c', '°C')])[0]?.expression).toBe('hk.lens_c - hk.board_c');
});

import { expect, test } from 'vitest';
import { lastOf, valuesText, type Entry } from './procedures';

const entry = (step: string, state: Entry['state']): Entry => ({
  step,
  title: step,
  kind: 'check',
  state,
  by: 'ann',
  began: '',
  ended: '',
  detail: '',
  values: null,
  command_id: null,
  due: '',
  note: '',
});

test('a step that was run again shows its last entry', () => {
  const entries = [entry('a', 'failed'), entry('b', 'done'), entry('a', 'done')];
  expect(lastOf(entries, 'a')?.state).toBe('done');
  expect(lastOf(entries, 'c')).toBeUndefined();
});

test('the values of a condition are words, unknown ones too', () => {
  expect(valuesText({ 'hk.t': 3.5, 'hk.on': true, 'hk.n': null })).toBe('hk.t = 3.5, hk.on = true, hk.n = unknown');
  expect(valuesText(null)).toBe('');
});

import { expect, test } from 'vitest';
import { inlineParts, lastOf, readTextProcedure, valuesText, type Entry } from './procedures';

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

test('a procedure of a package is read as paragraphs and numbered steps', () => {
  const text = '# Name\n\nPurpose.\n\n1. Open *Live*.\n2. Send `SET_TIME`\n   with the time.\n\nAfterwards.\n';
  expect(readTextProcedure(text)).toEqual({
    before: ['Purpose.'],
    steps: ['Open *Live*.', 'Send `SET_TIME` with the time.'],
    after: ['Afterwards.'],
  });
});

test('emphasis and code of a line are separate parts; single marks stay text', () => {
  expect(inlineParts('On *Live*, send `X`: 2 * 3')).toEqual([
    { kind: 'text', text: 'On ' },
    { kind: 'em', text: 'Live' },
    { kind: 'text', text: ', send ' },
    { kind: 'code', text: 'X' },
    { kind: 'text', text: ': 2 * 3' },
  ]);
});

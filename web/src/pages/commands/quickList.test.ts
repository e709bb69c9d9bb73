import { readFileSync } from 'node:fs';
import { describe, expect, it } from 'vitest';
import type { Step } from '../procedures/procedures';
import { blank, rowsOf, textOf } from './quickList';

/** A stack as the migration of the database writes it; its test compares the same file. */
const CONVERTED = readFileSync(new URL('../../../../tests/store/quick_list.md', import.meta.url), 'utf8');

/** Return a step as the server reads it. */
const step = (kind: Step['kind'], words: string, more: Partial<Step> = {}): Step => ({
  id: '',
  title: '',
  text: '',
  kind,
  words,
  seconds: 0,
  branches: [],
  confirm_name: '',
  hazard_reason: '',
  ...more,
});
const CHECK = {
  title: 'procedure 1 (2)',
  introduction: '> before\n> the pass',
  steps: [
    step('command', 'GET_STATUS', { text: '> first\n> # light' }),
    step('wait', '1.5 s', { seconds: 1.5 }),
    step('check', 'housekeeping.mode != "tracking"', { seconds: 20 }),
    step('command', 'SET_EXPOSURE exposure_ms=120'),
  ],
};

describe('a quick list', () => {
  it('is read from a converted stack and written with the same text', () => {
    const rows = rowsOf(CHECK, CONVERTED);
    expect(rows?.map((r) => [r.command, r.texts, r.delay, r.field, r.op, r.value, r.within])).toEqual([
      ['GET_STATUS', {}, '', '', '==', '', '10'],
      ['SET_EXPOSURE', { exposure_ms: '120' }, '1.5', 'housekeeping.mode', '!=', 'tracking', '20'],
    ]);
    expect(textOf(CHECK.title, CHECK.introduction, rows ?? [])).toBe(CONVERTED);
  });
  it('keeps arguments with spaces and quotes', () => {
    const rows = [{ ...blank('NOTE'), texts: { text: `it's "so"`, n: '1', empty: '' } }];
    const text = textOf('T', '', rows);
    const words = /```command\n(.*)\n/.exec(text)?.[1] ?? '';
    expect(rowsOf({ title: 'T', introduction: '', steps: [step('command', words)] }, text)).toEqual(rows);
  });
  it('excludes procedures with other steps, targets or texts', () => {
    const other = [step('question', 'Dark?')];
    expect(rowsOf({ ...CHECK, steps: [...CHECK.steps, ...other] }, CONVERTED)).toBeNull();
    expect(rowsOf(CHECK, CONVERTED.replace('within: 20 s', 'within: 20 s\nelse: end'))).toBeNull();
    expect(rowsOf(CHECK, CONVERTED.replace('Wait before', 'Pause before'))).toBeNull();
  });
});

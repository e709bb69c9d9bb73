import { expect, it } from 'vitest';
import type { RehearsalReport } from '../../api/types';
import { passLanes, recordLines, rehearsalOptions } from './rehearsal';

it('reads answers and losses of signal, a line each', () => {
  expect(rehearsalOptions('clear: yes\n\n mode : a: b ', '1, 120, 30\n2,0,1.5')).toEqual({
    options: {
      answers: { clear: 'yes', mode: 'a: b' },
      outages: [
        { pass_number: 1, after_s: 120, for_s: 30 },
        { pass_number: 2, after_s: 0, for_s: 1.5 },
      ],
    },
    problem: '',
  });
});

it('names the first line that cannot be read', () => {
  expect(rehearsalOptions('clear', '').problem).toContain('“clear” is not an answer');
  for (const line of ['1, 120', '0, 1, 1', '1.5, 1, 1', '1, -1, 1', '1, 1, 0', '1, x, 1', '1,2,3,4'])
    expect(rehearsalOptions('', line).problem).toContain('is not a loss of signal');
});

const REPORT = {
  items: [
    { started: '2026-11-26T18:46:10Z' },
    { started: '2026-11-26T18:46:25Z' },
    { started: '2026-11-26T20:20:19Z' },
    { started: null },
  ],
  passes: [
    { rise: '2026-11-26T18:46:00Z', set: '2026-11-26T18:49:40Z' },
    { rise: '2026-11-26T20:20:00Z', set: '2026-11-26T20:27:00Z' },
  ],
  transitions: [
    { at: '2026-11-26T18:44:00Z', state: 'armed', reason: '' },
    { at: '2026-11-26T18:46:10Z', state: 'running', reason: '' },
    { at: '2026-11-26T18:46:40Z', state: 'paused', reason: 'loss of signal' },
    { at: '2026-11-26T20:20:13Z', state: 'running', reason: '' },
    { at: '2026-11-26T20:20:30Z', state: 'failed', reason: 'no image' },
  ],
  person: [{ at: '2026-11-26T18:46:20Z', step: 'clear', kind: 'question', answer: 'yes', user: 'rehearsal' }],
} as unknown as RehearsalReport;

it('shows an interrupted item in both passes, and an item that was not started in none', () => {
  const [first, second] = passLanes(REPORT);
  expect(first?.running).toEqual([{ from: 10, to: 40 }]);
  expect(first?.items).toEqual([
    { from: 10, to: 25, item: 0 },
    { from: 25, to: 40, item: 1 },
  ]);
  expect(second?.window_s).toBe(420);
  expect(second?.items).toEqual([
    { from: 13, to: 19, item: 1 },
    { from: 19, to: 30, item: 2 },
  ]);
});

it('lists state changes and answers in order of time', () => {
  expect(recordLines(REPORT).map((line) => line.text)).toEqual([
    'armed',
    'running',
    'question clear, answered by the rehearsal: yes',
    'paused: loss of signal',
    'running',
    'failed: no image',
  ]);
});

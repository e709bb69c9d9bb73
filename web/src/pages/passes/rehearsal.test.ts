import { expect, it } from 'vitest';
import { rehearsalOptions } from './rehearsal';

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

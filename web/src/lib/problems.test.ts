import { describe, expect, it } from 'vitest';
import { ApiError } from '../api/client';
import { problemOf, problemText } from './problems';

describe('a problem', () => {
  const problem = { id: 'ab12', message: 'No such bank.', expected: 'A, B or C', got: 'D', hint: 'Look at Banks.' };

  it('is shown as the server described it, in a block and in a line', () => {
    const error = new ApiError(404, problem);
    expect(problemOf(error)).toEqual(problem);
    expect(problemText(error)).toBe('No such bank. Expected A, B or C; got D. Look at Banks.');
  });

  it('omits the parts that the server did not send', () => {
    expect(problemText(new ApiError(404, { ...problem, expected: '' }))).toBe('No such bank. Got D. Look at Banks.');
  });

  it('shows a defect of the page as a defect', () => {
    expect(problemOf(new TypeError('x is undefined')).message).toBe('TypeError: x is undefined.');
  });
});

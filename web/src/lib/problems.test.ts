import { describe, expect, it } from 'vitest';
import { ApiError } from '../api/client';
import { problemOf, problemText } from './problems';

describe('what went wrong', () => {
  const told = { id: 'ab12', message: 'no such bank', expected: 'A, B or C', got: 'D', hint: 'Look at Banks.' };

  it('is said as the server said it, in a block and in a line', () => {
    const error = new ApiError(404, told);
    expect(problemOf(error)).toEqual(told);
    expect(problemText(error)).toBe('no such bank, expected A, B or C, got D. Look at Banks.');
  });

  it('leaves no gaps for what the server did not say', () => {
    expect(problemText(new ApiError(404, { ...told, expected: '', hint: '' }))).toBe('no such bank, got D');
  });

  it('shows a defect of the page as what it is', () => {
    expect(problemOf(new TypeError('x is undefined')).message).toBe('TypeError: x is undefined');
  });
});

/** Description of a failed request: as the block that Problem.svelte shows, or in one line. */
import { ApiError } from '../api/client';
import type { Problem } from '../api/types';

export function problemOf(error: unknown): Problem {
  return error instanceof ApiError
    ? error.problem
    : { id: '', message: String(error), expected: '', got: '', hint: '' };
}

export function problemText(error: unknown): string {
  const p = problemOf(error);
  const parts = [p.message, p.expected && `expected ${p.expected}`, p.got && `got ${p.got}`].filter(Boolean).join(', ');
  return p.hint ? `${parts}. ${p.hint}` : parts;
}

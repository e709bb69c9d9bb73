/** Description of a failed request: as the block that Problem.svelte shows, or in one line. */
import { ApiError } from '../api/client';
import type { Problem } from '../api/types';
import { sentence } from './sentence';

export function problemOf(error: unknown): Problem {
  return error instanceof ApiError
    ? error.problem
    : { id: '', message: sentence(String(error)), expected: '', got: '', hint: '' };
}

/** What was expected and received, as a sentence; empty if the server did not state it. */
export function factsText(p: Problem): string {
  return sentence([p.expected && `expected ${p.expected}`, p.got && `got ${p.got}`].filter(Boolean).join('; '));
}

export function problemText(error: unknown): string {
  const p = problemOf(error);
  return [p.message, factsText(p), p.hint].filter(Boolean).join(' ');
}

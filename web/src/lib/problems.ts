/** Return the description of a failed request, as Problem.svelte shows it. */
import { ApiError } from '../api/client';
import type { Problem } from '../api/types';
import { sentence } from './sentence';

export function problemOf(error: unknown): Problem {
  return error instanceof ApiError
    ? error.problem
    : { id: '', message: sentence(String(error)), expected: '', got: '', hint: '' };
}

/** Return a sentence with the expected and the received value; empty if the server did not state them. */
export function factsText(p: Problem): string {
  return sentence([p.expected && `expected ${p.expected}`, p.got && `got ${p.got}`].filter(Boolean).join('; '));
}

export function problemText(error: unknown): string {
  const p = problemOf(error);
  return [p.message, factsText(p), p.hint].filter(Boolean).join(' ');
}

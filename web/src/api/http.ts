/** HTTP access to the server: typed by its OpenAPI document, so that a wrong path or body does not compile. */
import { base, inside } from '../lib/base';
import createClient from 'openapi-fetch';
import type { paths } from './generated/schema';
import type * as T from './types';

export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly problem: T.Problem,
  ) {
    super(problem.message);
  }
}

/** What the session adds to requests, and whom it informs of a 401 (state/session.svelte.ts sets it). */
export const door = {
  mark: '1',
  refused: (): Promise<void> => Promise.resolve(),
  back: (): Promise<void> => Promise.resolve(),
};
/** Requests without a session: a 401 response is an answer and does not end the session. */
const OPEN = [
  '/api/session',
  '/api/session/password',
  '/api/setup',
  '/api/password-links',
  '/api/password-links/check',
];
/** Browsers limit the bodies of requests that outlive their page to 64 KiB; half of it leaves room for several. */
const KEEPALIVE_BYTES = 32_768;

function problemOf(status: number, body: unknown): T.Problem {
  const given = (body ?? {}) as Partial<T.Problem> & { detail?: unknown };
  const fallback = typeof given.detail === 'string' ? given.detail : `The server answered with status ${status}.`;
  return {
    id: given.id ?? '',
    message: given.message ?? fallback,
    expected: given.expected ?? '',
    got: given.got ?? '',
    hint: given.hint ?? '',
  };
}

function aborted(signal: AbortSignal): Promise<never> {
  return new Promise((_, reject) => {
    const stop = (): void => reject(new DOMException('no longer needed', 'AbortError'));
    if (signal.aborted) stop();
    signal.addEventListener('abort', stop, { once: true });
  });
}

/** A change outlives its page: ABORT is sent even if the page is closed right after the key press. */
export class OutlivingRequest extends Request {
  constructor(input: RequestInfo | URL, init?: RequestInit) {
    const small = init?.body == null || (typeof init.body === 'string' && init.body.length < KEEPALIVE_BYTES);
    const change = init?.method !== undefined && init.method !== 'GET';
    super(input, { ...init, keepalive: init?.keepalive ?? (change && small) });
  }
}

/**
 * Return a successful response. Throw the problem that the server described. If the session has ended, a read waits
 * for the next sign-in and is repeated; a change is never repeated.
 */
export async function fetched(request: Request): Promise<Response> {
  const read = request.method === 'GET';
  if (!read) request.headers.set('X-GSS', door.mark);
  let response: Response;
  try {
    response = await fetch(request);
  } catch (error) {
    if (error instanceof DOMException && error.name === 'AbortError') throw error;
    const hint = read
      ? 'The page reads it again when the server is back.'
      : 'The request is not repeated. Check whether it took effect before you repeat it.';
    throw new ApiError(0, { id: '', message: 'No answer from the server.', expected: '', got: '', hint });
  }
  if (response.ok) return response;
  if (response.status === 401 && !OPEN.includes(inside(new URL(request.url).pathname) ?? '')) {
    await door.refused();
    if (read) {
      await Promise.race([door.back(), aborted(request.signal)]);
      return fetched(request);
    }
  }
  throw new ApiError(response.status, problemOf(response.status, await response.json().catch(() => null)));
}

export const http = createClient<paths>({
  baseUrl: (globalThis.location?.origin ?? '') + base,
  fetch: fetched,
  Request: OutlivingRequest,
});

/** The body of a response. `fetched` throws errors, so there always is a body, except after 204. */
export async function body<D>(answer: Promise<{ data?: D }>): Promise<D> {
  return (await answer).data as D;
}

/** The query parameters without the empty ones. */
export function given<Q extends object>(query: Q): Q {
  return Object.fromEntries(Object.entries(query).filter(([, v]) => v !== undefined && v !== '')) as Q;
}

/** The query string of a link that the browser follows. */
export function search(values: Record<string, string | number | undefined>): string {
  const pairs = Object.entries(given(values)).map(([k, v]) => [k, String(v)] as [string, string]);
  return pairs.length ? `?${new URLSearchParams(pairs).toString()}` : '';
}

/** A multipart body from its fields; files are sent as they are. */
export function multipart(fields: Record<string, unknown>): FormData {
  const form = new FormData();
  for (const [name, value] of Object.entries(fields))
    if (value !== undefined && value !== '') form.append(name, value instanceof Blob ? value : String(value));
  return form;
}

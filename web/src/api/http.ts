/**
 * HTTP access to the server. The types are generated from the server's OpenAPI document, so that a wrong path or body
 * does not compile.
 */
import { base, localPath } from '../lib/base';
import createClient from 'openapi-fetch';
import type { paths } from './generated/schema';
import type * as T from './types';

/** Statuses from here on can come from a proxy in front of a server that is down. */
const PROXY_ERROR = 500;

export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly problem: T.Problem,
  ) {
    super(problem.message);
  }
}

/**
 * Values and callbacks of the session, set by state/session.svelte.ts: the CSRF token of requests, the reaction to a
 * 401 response, and a promise that resolves after the next sign-in. `answered`, set by state/live.svelte.ts: called
 * after a response of the server.
 */
export const sessionHooks = {
  csrfToken: '1',
  onUnauthorized: (): Promise<void> => Promise.resolve(),
  signedIn: (): Promise<void> => Promise.resolve(),
  answered: (): void => undefined,
};
/** Paths that need no session. A 401 response from them does not mean that the session has ended. */
const OPEN = [
  '/api/session',
  '/api/session/password',
  '/api/setup',
  '/api/password-links',
  '/api/password-links/check',
];
/**
 * Browsers permit at most 64 KiB in all bodies of requests that continue after their page is closed. With half of this
 * as the limit of one body, several requests can continue.
 */
const KEEPALIVE_BYTES = 32_768;

function problemOf(status: number, body: unknown): T.Problem {
  const problem = (body ?? {}) as Partial<T.Problem> & { detail?: unknown };
  const fallback = typeof problem.detail === 'string' ? problem.detail : `The server answered with status ${status}.`;
  return {
    id: problem.id ?? '',
    message: problem.message ?? fallback,
    expected: problem.expected ?? '',
    got: problem.got ?? '',
    hint: problem.hint ?? '',
  };
}

function aborted(signal: AbortSignal): Promise<never> {
  return new Promise((_, reject) => {
    const stop = (): void => reject(new DOMException('no longer needed', 'AbortError'));
    if (signal.aborted) stop();
    signal.addEventListener('abort', stop, { once: true });
  });
}

/**
 * A request that continues after its page is closed if it is a small change. ABORT is therefore sent even if the page
 * is closed directly after the key press.
 */
export class OutlivingRequest extends Request {
  constructor(input: RequestInfo | URL, init?: RequestInit) {
    const isSmall = init?.body == null || (typeof init.body === 'string' && init.body.length < KEEPALIVE_BYTES);
    const isChange = init?.method !== undefined && init.method !== 'GET';
    super(input, { ...init, keepalive: init?.keepalive ?? (isChange && isSmall) });
  }
}

/**
 * Send a request and return its successful response. Throws the problem that the server described. If the session has
 * ended, a read waits for the next sign-in and is then repeated; a change is never repeated.
 */
export async function fetched(request: Request): Promise<Response> {
  const read = request.method === 'GET';
  if (!read) request.headers.set('X-GSS', sessionHooks.csrfToken);
  let response: Response;
  try {
    response = await fetch(request);
  } catch (error) {
    if (error instanceof DOMException && error.name === 'AbortError') throw error;
    const hint = read
      ? 'The page repeats the request when the server is reachable again.'
      : 'The request is not repeated automatically. Check whether it took effect before you repeat it.';
    throw new ApiError(0, { id: '', message: 'No answer from the server.', expected: '', got: '', hint });
  }
  if (response.status < PROXY_ERROR) sessionHooks.answered();
  if (response.ok) return response;
  if (response.status === 401 && !OPEN.includes(localPath(new URL(request.url).pathname) ?? '')) {
    await sessionHooks.onUnauthorized();
    if (read) {
      await Promise.race([sessionHooks.signedIn(), aborted(request.signal)]);
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

/** Return the body of a response. `fetched` throws errors, so a body exists, except after status 204. */
export async function body<D>(answer: Promise<{ data?: D }>): Promise<D> {
  return (await answer).data as D;
}

/** Return the query parameters that are not empty. */
export function given<Q extends object>(query: Q): Q {
  return Object.fromEntries(Object.entries(query).filter(([, v]) => v !== undefined && v !== '')) as Q;
}

/** Return the query string of a link, with the parameters that are not empty. */
export function queryString(values: Record<string, string | number | undefined>): string {
  const pairs = Object.entries(given(values)).map(([k, v]) => [k, String(v)] as [string, string]);
  return pairs.length ? `?${new URLSearchParams(pairs).toString()}` : '';
}

/** Return a multipart body. Files are sent unchanged. */
export function multipart(fields: Record<string, unknown>): FormData {
  const form = new FormData();
  for (const [name, value] of Object.entries(fields))
    if (value !== undefined && value !== '') form.append(name, value instanceof Blob ? value : String(value));
  return form;
}

import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest';
import { ApiError, body, sessionHooks, given, http, multipart, queryString } from './http';

const sent: Request[] = [];
let answers: Response[] = [];
const json = (status: number, value: unknown): Response => new Response(JSON.stringify(value), { status });

beforeEach(() => {
  sent.length = 0;
  vi.stubGlobal('fetch', (request: Request) => {
    sent.push(request);
    const next = answers.shift();
    return next ? Promise.resolve(next) : Promise.reject(new TypeError('connection refused'));
  });
  sessionHooks.csrfToken = 'csrf-1';
});
afterEach(() => vi.unstubAllGlobals());
const post = (signal?: AbortSignal) =>
  http.POST('/api/commands', { baseUrl: 'http://gss', body: { name: 'PING' }, ...(signal && { signal }) });

describe('requests', () => {
  it('send changes with the CSRF header, even after their page was closed', async () => {
    answers = [json(201, { id: 4 })];
    expect(await body(post())).toEqual({ id: 4 });
    expect(sent[0]?.headers.get('X-GSS')).toBe('csrf-1');
    expect(sent[0]?.keepalive).toBe(true);
    expect(await sent[0]?.json()).toEqual({ name: 'PING' });
  });
  it('send ABORT even after its page was closed, although it can be cancelled', async () => {
    answers = [json(201, {})];
    const { signal } = new AbortController();
    await http.POST('/api/commands/abort', { baseUrl: 'http://gss', signal });
    expect(sent[0]?.keepalive).toBe(true);
    expect(new URL(sent[0]?.url ?? '').pathname).toBe('/api/commands/abort');
  });
  it('send reads and long bodies without keepalive, whose size browsers limit', async () => {
    answers = [json(200, {}), json(201, {})];
    await http.GET('/api/link', { baseUrl: 'http://gss' });
    await http.POST('/api/procedures', { baseUrl: 'http://gss', body: { text: 'x'.repeat(40_000) } });
    expect(sent.map((r) => r.keepalive)).toEqual([false, false]);
    expect(sent[0]?.headers.get('X-GSS')).toBeNull();
  });
});

describe('answers', () => {
  it('report that the server is reachable, unless a proxy can have sent them', async () => {
    let answered = 0;
    sessionHooks.answered = () => (answered += 1);
    answers = [json(200, {}), json(412, {}), json(502, {})];
    for (let n = 0; n < 4; n += 1) await http.GET('/api/link', { baseUrl: 'http://gss' }).catch(() => undefined);
    expect(answered).toBe(2);
  });
  it('throw the problem that the server described', async () => {
    answers = [
      json(409, { id: 'a1', message: 'the link is closed', expected: 'open', got: 'closed', hint: 'open it' }),
    ];
    const error = await post().catch((e: unknown) => e);
    expect(error).toBeInstanceOf(ApiError);
    expect((error as ApiError).status).toBe(409);
    expect((error as ApiError).problem.hint).toBe('open it');
  });
  it('throw a problem with status 0 without a response, and state that a change is not repeated', async () => {
    answers = [];
    const error = (await post().catch((e: unknown) => e)) as ApiError;
    expect(error.status).toBe(0);
    expect(error.problem.hint).toContain('not repeated');
  });
  it('repeat a read after the next sign-in, never a change', async () => {
    let signIn = (): void => undefined;
    sessionHooks.onUnauthorized = vi.fn(() => Promise.resolve());
    sessionHooks.signedIn = () => new Promise((resolve) => (signIn = resolve));
    answers = [json(401, {}), json(200, { utc: 'now' })];
    const read = body(http.GET('/api/link', { baseUrl: 'http://gss' }));
    await vi.waitFor(() => expect(sessionHooks.onUnauthorized).toHaveBeenCalledOnce());
    expect(sent).toHaveLength(1);
    await Promise.resolve();
    signIn();
    expect(await read).toEqual({ utc: 'now' });
    answers = [json(401, {}), json(201, {})];
    expect(((await post().catch((e: unknown) => e)) as ApiError).status).toBe(401);
    expect(sent).toHaveLength(3);
  });
});

describe('parameters', () => {
  it('omit empty ones', () => {
    expect(given({ a: '', b: undefined, c: 0, d: 'x' })).toEqual({ c: 0, d: 'x' });
    expect(queryString({ start: '', limit: 5 })).toBe('?limit=5');
    expect(queryString({})).toBe('');
    expect([...multipart({ file: new Blob(['x']), profile: '' }).keys()]).toEqual(['file']);
  });
});

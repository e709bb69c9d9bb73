/** Password requirements, in words. The server applies the same minimum length and the same refusals. */
export const LEAST = 10;
export const MOST = 200;

export interface Verdict {
  ok: boolean;
  state: 'never' | 'critical' | 'watch' | 'ok';
  text: string;
}

function monotone(password: string): boolean {
  return new Set(password.toLowerCase()).size < 5;
}

/** Length first: a long, memorable password is better than a short, complex one. */
export function judge(password: string, name: string): Verdict {
  if (!password)
    return {
      ok: false,
      state: 'never',
      text: `at least ${LEAST} characters; a few words you remember are better than signs`,
    };
  const length = [...password].length;
  if (length < LEAST) return { ok: false, state: 'critical', text: `too short: ${length} of ${LEAST} characters` };
  if (length > MOST) return { ok: false, state: 'critical', text: `too long: ${length}, at most ${MOST} characters` };
  if (monotone(password))
    return { ok: false, state: 'critical', text: 'too simple: fewer than five different characters' };
  if (name && password.toLowerCase() === name.toLowerCase())
    return { ok: false, state: 'critical', text: 'it is the name' };
  return length < 16
    ? { ok: true, state: 'ok', text: `${length} characters: good enough` }
    : { ok: true, state: 'ok', text: `${length} characters: strong` };
}

/** Password requirements and their messages. The server applies the same rules. */
export const MIN_LENGTH = 10;
export const MAX_LENGTH = 200;

export interface Verdict {
  ok: boolean;
  state: 'never' | 'critical' | 'watch' | 'ok';
  text: string;
}

function isRepetitive(password: string): boolean {
  return new Set(password.toLowerCase()).size < 5;
}

/** Length first: a long, memorable password is better than a short, complex one. */
export function judge(password: string, name: string): Verdict {
  if (!password)
    return {
      ok: false,
      state: 'never',
      text: `at least ${MIN_LENGTH} characters; several words are better than special characters`,
    };
  const length = [...password].length;
  if (length < MIN_LENGTH)
    return { ok: false, state: 'critical', text: `too short: ${length} of ${MIN_LENGTH} characters` };
  if (length > MAX_LENGTH)
    return { ok: false, state: 'critical', text: `too long: ${length}, at most ${MAX_LENGTH} characters` };
  if (isRepetitive(password))
    return { ok: false, state: 'critical', text: 'too simple: fewer than five different characters' };
  if (name && password.toLowerCase() === name.toLowerCase())
    return { ok: false, state: 'critical', text: 'same as the user name' };
  return length < 16
    ? { ok: true, state: 'ok', text: `${length} characters: good enough` }
    : { ok: true, state: 'ok', text: `${length} characters: strong` };
}

import { describe, expect, it } from 'vitest';
import { judge, MIN_LENGTH } from './password';

describe('judge', () => {
  it('states what is missing', () => {
    expect(judge('', 'ann').ok).toBe(false);
    expect(judge('short', 'ann').text).toBe(`too short: 5 of ${MIN_LENGTH} characters`);
    expect(judge('aaaaaaaaaaaaaaaa', 'ann').text).toContain('too simple');
    expect(judge('Annabelle Orion', 'annabelle orion').text).toBe('same as the user name');
    expect(judge('x'.repeat(10) + 'abcdefgh'.repeat(30), 'ann').text).toContain('at most');
  });
  it('prefers length', () => {
    expect(judge('orion and rigel', 'ann')).toMatchObject({ ok: true, state: 'ok' });
    expect(judge('four words one sky', 'ann').text).toContain('strong');
  });
});

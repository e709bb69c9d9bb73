import { describe, expect, it } from 'vitest';
import { parseUtcTime } from './utcTime';

describe('a time in UTC', () => {
  it('is parsed in the usual notations', () => {
    expect(parseUtcTime('2026-12-01')).toBe('2026-12-01T00:00:00Z');
    expect(parseUtcTime(' 2026-12-01 18:42 ')).toBe('2026-12-01T18:42:00Z');
    expect(parseUtcTime('2026-12-01T18:42:07z')).toBe('2026-12-01T18:42:07Z');
  });
  it('is rejected if it does not exist', () => {
    for (const text of ['', 'yesterday', '12/01/2026', '2026-12-01 25:00', '2026-02-30'])
      expect(parseUtcTime(text)).toBeNull();
  });
});

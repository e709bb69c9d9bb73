import { describe, expect, it } from 'vitest';
import { readMoment } from './moment';

describe('a moment in UTC', () => {
  it('is read as people write it', () => {
    expect(readMoment('2026-12-01')).toBe('2026-12-01T00:00:00Z');
    expect(readMoment(' 2026-12-01 18:42 ')).toBe('2026-12-01T18:42:00Z');
    expect(readMoment('2026-12-01T18:42:07z')).toBe('2026-12-01T18:42:07Z');
  });
  it('is refused where it is none', () => {
    for (const text of ['', 'yesterday', '12/01/2026', '2026-12-01 25:00', '2026-02-30']) expect(readMoment(text)).toBeNull();
  });
});

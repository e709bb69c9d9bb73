import { describe, expect, it } from 'vitest';
import type { ContactRecord } from '../../api/types';
import { counterRows, coverage, recordWords } from './lanes';

const record = (held: number, expected: number, gaps: number, unexplained = 0): ContactRecord => ({
  contact_id: 1,
  expected,
  held,
  share: held / expected,
  unexplained,
  late: [],
  gaps: Array.from({ length: gaps }, (_, i) => ({
    start: `2026-12-01T18:00:${10 + i}Z`,
    end: `2026-12-01T18:00:${12 + i}Z`,
    missing: 1,
    cause: i < unexplained ? 'unexplained' : 'lost on the line',
    explained: i >= unexplained,
  })),
});

it('labels each counter of a contact with what it counts', () => {
  expect(counterRows({ good: 4365, unframed: 2, sent_good: 458, new_counter: 1 })).toEqual([
    ['packets received', 4365],
    ['bytes outside packets', 2],
    ['packets sent', 458],
    ['new counter', 1],
  ]);
});

describe('the record of a contact', () => {
  it('is 100 % only if no packet is missing', () => {
    expect(coverage(record(20_000, 20_000, 0))).toBe('100.00');
    expect(coverage(record(99_999, 100_000, 1))).toBe('99.99');
    expect(coverage(record(206, 222, 16))).toBe('92.79');
  });
  it('counts gaps and missing packets as the pass report does', () => {
    expect(recordWords(record(10, 10, 0))).toBe('no gap');
    expect(recordWords(record(206, 222, 16))).toBe('16 gaps, 16 packets missing, all explained');
    expect(recordWords(record(9, 10, 1, 1))).toBe('1 gap, 1 packet missing, 1 unexplained');
  });
});

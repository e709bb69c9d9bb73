import { describe, expect, it } from 'vitest';
import { eventMarks } from './eventMarks';
import type { Happening } from './happenings.svelte';

const item = (t: number, over: Partial<Happening> = {}): Happening => ({
  key: `k${t}`,
  t,
  kind: 'command',
  text: `text ${t}`,
  short: `short ${t}`,
  state: 'ok',
  ...over,
});
const pixels =
  (perSecond: number) =>
  (t: number): number =>
    t * perSecond;

describe('marks of the event lane', () => {
  it('have one mark with a count for items of the same second, in the state of the most severe one', () => {
    const [mark, ...others] = eventMarks(
      [item(5), item(5.2, { kind: 'event', state: 'critical' }), item(5.9, { state: 'watch' })],
      pixels(2),
    );
    expect(others).toEqual([]);
    expect(mark).toMatchObject({ x: 10, count: 3, kind: 'event', state: 'critical', label: '3: short 5.2' });
    expect(mark?.text.split('\n')).toEqual(['text 5', 'text 5.2', 'text 5.9']);
  });
  it('are separate if they do not overlap, also after zooming into the second', () => {
    expect(eventMarks([item(5), item(11)], pixels(2)).map((m) => [m.count, m.label])).toEqual([
      [1, 'short 5'],
      [1, 'short 11'],
    ]);
    expect(eventMarks([item(5), item(5.5)], pixels(40))).toHaveLength(2);
  });
  it('never overlap, however close the items are', () => {
    const marks = eventMarks(
      Array.from({ length: 100 }, (_, k) => item(k * 0.7)),
      pixels(3),
    );
    expect(marks.reduce((n, m) => n + m.count, 0)).toBe(100);
    for (const [i, m] of marks.entries()) if (i) expect(m.x - (marks[i - 1]?.x ?? 0)).toBeGreaterThanOrEqual(10);
  });
});

import { describe, expect, it } from 'vitest';
import type { EventRow } from '../api/types';
import { SILENT_MS, Stream, type StreamHandlers, type StreamSource, type TopicHandlers } from './stream';

const row = (seq: number): EventRow => ({
  seq,
  at: `2026-12-01T18:35:${20 + seq}.000Z`,
  kind: 'x',
  severity: 'info',
  text: `e${seq}`,
  data: {},
});

class Fake implements StreamSource {
  onopen: ((e: Event) => void) | null = null;
  onerror: ((e: Event) => void) | null = null;
  closed = false;
  addEventListener(): void {}
  close(): void {
    this.closed = true;
  }
}

/** `restored`: the server returns its latest events, because the number is of another database. */
function rig(missed: EventRow[] = [], restored = false) {
  const log: string[] = [];
  const sources: { after: number; fake: Fake }[] = [];
  const waits: { ms: number; run: () => void }[] = [];
  const checks: (() => void)[] = [];
  const clock = { ms: 7 };
  const handlers: StreamHandlers = {
    topics: new Proxy({} as TopicHandlers, {
      get: (_, topic: string) => (message: EventRow) => log.push(topic === 'event' ? `event ${message.seq}` : topic),
    }),
    online: (filled) => log.push(filled ? `back ${filled.count}` : 'online'),
    offline: (since) => log.push(`offline ${since}`),
  };
  const stream = new Stream(
    {
      open: (after) => {
        const fake = new Fake();
        sources.push({ after, fake });
        return fake;
      },
      backfill: async (after) => missed.filter((e) => restored || e.seq > after),
      later: (run, ms) => waits.push({ ms, run }),
      watch: (check) => checks.push(check),
      now: () => clock.ms,
    },
    handlers,
  );
  return { stream, log, sources, waits, checks, clock };
}
const event = (seq: number): ['event', string, string] => ['event', JSON.stringify(row(seq)), String(seq)];
const settle = (): Promise<void> => new Promise((r) => setTimeout(r, 0));

describe('the event stream', () => {
  it('handles a recorded event once, however often it arrives', () => {
    const { stream, log } = rig();
    stream.start();
    for (const seq of [1, 2, 2, 1, 3]) stream.received(...event(seq));
    expect(log).toEqual(['event 1', 'event 2', 'event 3']);
    expect(stream.lastSeq).toBe(3);
  });
  it('always accepts states without a number', () => {
    const { stream, log } = rig();
    stream.received('link', '{}', '');
    stream.received('link', '{}', '');
    expect(log).toEqual(['link', 'link']);
  });
  it('reports a jump in the count of states as a loss, once, and none after an announced loss', () => {
    const { stream, log } = rig();
    for (const id of ['7.3', '7.4', '7.6', '7.7']) stream.received('link', '{}', id);
    expect(log).toEqual(['link', 'link', 'dropped', 'link', 'link']);
    stream.received('dropped', '{"dropped":5}', '');
    stream.received('link', '{}', '7.13');
    expect(log.filter((l) => l === 'dropped').length).toBe(2);
  });
  it('fetches recorded events that a jump in their numbers shows to be missing', async () => {
    const { stream, log } = rig([row(2), row(3), row(4)]);
    stream.received(...event(1));
    stream.received(...event(4));
    await settle();
    expect(log).toEqual(['event 1', 'event 4', 'event 2', 'event 3']);
    expect(stream.lastSeq).toBe(4);
  });
  it('fetches what was recorded during an announced loss at once', async () => {
    const { stream, log } = rig([row(2), row(3)]);
    stream.received(...event(1));
    stream.received('dropped', '{"dropped":2}', '');
    await settle();
    expect(log).toEqual(['event 1', 'dropped', 'event 2', 'event 3']);
  });
  it('reports once that it is offline, waits longer each time, and resumes after the last number', () => {
    const { stream, log, sources, waits } = rig();
    stream.start();
    stream.received(...event(5));
    sources[0]?.fake.onerror?.(new Event('error'));
    waits[0]?.run();
    sources[1]?.fake.onerror?.(new Event('error'));
    expect(log).toEqual(['event 5', 'offline 7']);
    expect(waits.map((w) => w.ms)).toEqual([500, 1000]);
    expect(sources.map((s) => s.after)).toEqual([0, 5]);
    expect(sources[0]?.fake.closed).toBe(true);
  });
  it('fetches missed events before it reports that it is back', async () => {
    const { stream, log, sources, waits } = rig([row(1), row(2), row(3)]);
    stream.start();
    stream.received(...event(1));
    sources[0]?.fake.onerror?.(new Event('error'));
    waits[0]?.run();
    sources[1]?.fake.onopen?.(new Event('open'));
    await settle();
    expect(log).toEqual(['event 1', 'offline 7', 'event 2', 'event 3', 'back 2']);
  });
  it('continues after the newest event of another database, as after a restore', async () => {
    const { stream, log, sources, waits } = rig([row(1), row(2)], true);
    stream.start();
    stream.received(...event(9));
    sources[0]?.fake.onerror?.(new Event('error'));
    waits[0]?.run();
    sources[1]?.fake.onopen?.(new Event('open'));
    await settle();
    stream.received(...event(3));
    expect(log).toEqual(['event 9', 'offline 7', 'back 0', 'event 3']);
  });
  it('does not report that it is back if the connection fails while missed events are fetched', async () => {
    const { stream, log, sources, waits } = rig([row(1), row(2)]);
    stream.start();
    stream.received(...event(1));
    sources[0]?.fake.onerror?.(new Event('error'));
    waits[0]?.run();
    sources[1]?.fake.onopen?.(new Event('open'));
    sources[1]?.fake.onerror?.(new Event('error'));
    await settle();
    expect(log.filter((l) => l.startsWith('back'))).toEqual([]);
    waits[1]?.run();
    sources[2]?.fake.onopen?.(new Event('open'));
    await settle();
    expect(log.at(-1)).toBe('back 0');
  });
  it('does not fetch events as missed if it has received none', async () => {
    const { stream, log, sources, waits } = rig([row(1), row(2)]);
    stream.start();
    sources[0]?.fake.onerror?.(new Event('error'));
    waits[0]?.run();
    sources[1]?.fake.onopen?.(new Event('open'));
    await settle();
    expect(log).toEqual(['offline 7', 'back 0']);
  });
  it('connects at once, and only once, when the server has answered a request', () => {
    const { stream, sources, waits } = rig();
    stream.start();
    stream.reconnect();
    expect(sources.length).toBe(1);
    sources[0]?.fake.onerror?.(new Event('error'));
    stream.reconnect();
    waits[0]?.run();
    expect(sources.length).toBe(2);
  });
  it('connects again if no message arrives for some time', () => {
    const { stream, log, sources, waits, checks, clock } = rig();
    stream.start();
    clock.ms += SILENT_MS;
    stream.received('link', '{}', '');
    clock.ms += SILENT_MS;
    checks[0]?.();
    expect(log).toEqual(['link']);
    clock.ms += 1;
    checks[0]?.();
    expect(log).toEqual(['link', `offline ${clock.ms}`]);
    waits[0]?.run();
    expect([sources.length, sources[0]?.fake.closed]).toEqual([2, true]);
  });
  it('opens no new connection after it was stopped', () => {
    const { stream, sources, waits } = rig();
    stream.start();
    stream.stop();
    sources[0]?.fake.onerror?.(new Event('error'));
    expect(waits).toEqual([]);
  });
});

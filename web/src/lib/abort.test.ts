import { describe, expect, it } from 'vitest';
import { ApiError } from '../api/client';
import type { Abort, Command, Stage } from '../api/types';
import {
  answerOf,
  headlineOf,
  Presses,
  RECORD_MS,
  SEARCH_EVERY_MS,
  SEARCH_UNTIL_MS,
  stepsOf,
  WINDOW_MS,
  type Press,
} from './abort';

const START = Date.parse('2026-12-01T18:42:07Z');
const UNREACHABLE = (): ApiError => new ApiError(0, { id: '', message: 'no answer', expected: '', got: '', hint: '' });
const refused = (status: number, message: string, got = ''): ApiError =>
  new ApiError(status, { id: 'x', message, expected: '', got, hint: '' });
function command(over: Partial<Command> = {}): Command {
  const stages: Stage[] = [
    { name: 'queued', state: 'passed', at: '2026-12-01T18:42:07.100Z' },
    { name: 'sent', state: 'passed', at: '2026-12-01T18:42:07.200Z' },
  ];
  return {
    id: 5,
    request_id: 23,
    name: 'ABORT',
    user: 'kim',
    created: '2026-12-01T18:42:07.100Z',
    result: 'sent',
    detail: '',
    stages,
    ...over,
  } as Command;
}

const receipt = (command: Command | null): Abort => ({ request_id: 23, at: '2026-12-01T18:42:07.050Z', command });

/** A clock that moves only when it is advanced, a server that answers as `answers` specifies, and a storage. */
function rig(
  answers: (Command | Abort | Error | 'hang')[],
  over: { online?: boolean; reachable?: boolean | 'hang'; stored?: string; history?: Command[]; storage?: Error } = {},
) {
  let now = START;
  let timers: { at: number; run: () => void }[] = [];
  const seen: { presses: readonly Press[]; saved: string; posts: number; searches: number } = {
    presses: [],
    saved: over.stored ?? '[]',
    posts: 0,
    searches: 0,
  };
  const world: { online: boolean; reachable: boolean | 'hang'; history: Command[] | Error | 'hang' } = {
    online: over.online ?? true,
    reachable: over.reachable ?? over.online ?? true,
    history: over.history ?? [],
  };
  const presses = new Presses({
    post: () => {
      seen.posts += 1;
      const next = answers.length > 1 ? answers.shift() : answers[0];
      return next === 'hang'
        ? new Promise(() => undefined)
        : next instanceof Error
          ? Promise.reject(next)
          : Promise.resolve('stages' in (next as object) ? receipt(next as Command) : (next as Abort));
    },
    probe: () => (world.reachable === 'hang' ? new Promise(() => undefined) : Promise.resolve(world.reachable)),
    history: (start, end) => {
      seen.searches += 1;
      if (world.history === 'hang') return new Promise(() => undefined);
      return world.history instanceof Error
        ? Promise.reject(world.history)
        : Promise.resolve(world.history.filter((c) => Date.parse(c.created) >= start && Date.parse(c.created) < end));
    },
    online: () => world.online,
    now: () => now,
    user: () => 'kim',
    later: (run, ms) => {
      const timer = { at: now + ms, run };
      timers.push(timer);
      return () => {
        timers = timers.filter((t) => t !== timer);
      };
    },
    load: () => {
      if (over.storage) throw over.storage;
      return seen.saved;
    },
    save: (text) => {
      if (over.storage) throw over.storage;
      seen.saved = text;
    },
    changed: (list) => {
      seen.presses = list;
    },
  });
  const settle = (): Promise<void> => new Promise((r) => setTimeout(r, 0));
  async function pass(ms: number): Promise<void> {
    const end = now + ms;
    for (;;) {
      await settle();
      const due = timers.filter((t) => t.at <= end).sort((a, b) => a.at - b.at)[0];
      if (!due) break;
      timers = timers.filter((t) => t !== due);
      now = due.at;
      due.run();
    }
    now = end;
    await settle();
  }
  return { presses, seen, pass, world };
}

describe('a press of ABORT', () => {
  it('ends as not sent if the server is unreachable during the whole window', async () => {
    const { presses, seen, pass } = rig([UNREACHABLE()], { online: false });
    void presses.press();
    await pass(WINDOW_MS - 100);
    expect(seen.presses[0]?.fate).toBe('sending');
    await pass(200);
    expect(seen.presses[0]).toMatchObject({ fate: 'not_sent' });
    expect(headlineOf(seen.presses[0] as Press).word).toBe('ABORT NOT SENT');
    expect(headlineOf(seen.presses[0] as Press).text).toContain(
      'server could not be reached in 10 attempts within 5 s',
    );
  });
  it('sends nothing after the window, however long the server is unreachable', async () => {
    const { presses, seen, pass, world } = rig(
      [
        UNREACHABLE(),
        UNREACHABLE(),
        UNREACHABLE(),
        UNREACHABLE(),
        UNREACHABLE(),
        UNREACHABLE(),
        UNREACHABLE(),
        UNREACHABLE(),
        UNREACHABLE(),
        UNREACHABLE(),
        command(),
      ],
      { online: false },
    );
    void presses.press();
    await pass(WINDOW_MS + 1);
    const before = seen.posts;
    world.online = true;
    await pass(600_000);
    void presses.check();
    await pass(0);
    expect(seen.posts).toBe(before);
    expect(seen.presses[0]).toMatchObject({ fate: 'not_sent', notInHistory: true });
  });
  it('is sent when the server answers within the window', async () => {
    const { presses, seen, pass } = rig([UNREACHABLE(), UNREACHABLE(), command()], { online: false });
    void presses.press();
    await pass(1500);
    expect(seen.presses[0]).toMatchObject({ fate: 'recorded', tries: 3 });
  });
  it('is unknown, not "not sent", when the request left and the connection broke', async () => {
    const { presses, seen, pass } = rig([UNREACHABLE()], { online: true });
    void presses.press();
    await pass(WINDOW_MS);
    expect(seen.presses[0]?.fate).toBe('unknown');
    expect(headlineOf(seen.presses[0] as Press).text).toContain('may or may not have reached the sensor');
  });
  it('is unknown without a response in the window, and the request is cancelled', async () => {
    const { presses, seen, pass } = rig(['hang']);
    void presses.press();
    await pass(WINDOW_MS);
    expect(seen.presses[0]).toMatchObject({ fate: 'unknown', reason: 'no answer from the server within 5 s' });
    expect(seen.posts).toBe(1);
  });
  it('is not sent, with the reason, if the server refuses it because the line is down', async () => {
    const { presses, seen, pass } = rig([refused(409, 'the line is down', 'port closed')]);
    void presses.press();
    await pass(0);
    expect(headlineOf(seen.presses[0] as Press)).toEqual({
      word: 'ABORT NOT SENT',
      level: 'critical',
      text: 'The server answered 409: the line is down (port closed). The sensor has not received it.',
    });
  });
  it('does not claim "not sent" of a server error: the command may have left before it', () => {
    expect(answerOf(refused(500, 'the server has a defect'), true, false)).toEqual({
      fate: 'unknown',
      answered: true,
      reason: 'the server answered 500: the server has a defect',
    });
  });
  it('stays until it is acknowledged, also after a reload of the page', async () => {
    const first = rig([UNREACHABLE()], { online: false });
    void first.presses.press();
    await first.pass(WINDOW_MS);
    const second = rig([command()], { stored: first.seen.saved });
    expect(second.seen.presses[0]?.fate).toBe('not_sent');
    second.presses.acknowledge();
    expect(rig([command()], { stored: second.seen.saved }).seen.presses).toEqual([]);
  });
  it('is unknown if the page was reloaded before the response', async () => {
    const first = rig(['hang']);
    void first.presses.press();
    await first.pass(10);
    expect(rig([command()], { stored: first.seen.saved }).seen.presses[0]).toMatchObject({ fate: 'unknown' });
  });
  it('is followed if the history contains it', async () => {
    const { presses, seen, pass, world } = rig([UNREACHABLE()], { online: true });
    void presses.press();
    await pass(WINDOW_MS);
    world.history = [command({ id: 9, created: '2026-12-01T18:42:07.300Z', result: 'completed' })];
    void presses.check();
    await pass(0);
    expect(seen.presses[0]).toMatchObject({ fate: 'recorded', command: { id: 9 } });
  });
  it('is not confused with the ABORT of another user or another time', async () => {
    const { presses, seen, pass, world } = rig([UNREACHABLE()], { online: false });
    void presses.press();
    await pass(WINDOW_MS);
    world.history = [command({ user: 'lee' }), command({ created: '2026-12-01T18:30:00Z' })];
    void presses.check();
    await pass(0);
    expect(seen.presses[0]?.fate).toBe('not_sent');
  });
  it('shows pressed, sent, accepted and completed with the times of the command', async () => {
    const { presses, seen, pass } = rig([command()]);
    void presses.press();
    await pass(0);
    const points = (): string[] => stepsOf(seen.presses[0] as Press).map((s) => s.point);
    expect(points()).toEqual(['done', 'done', 'now', 'to_come']);
    const done = command({
      result: 'completed',
      stages: (['sent', 'accepted', 'completed'] as const).map((name) => ({
        name,
        state: 'passed',
        at: '2026-12-01T18:42:08Z',
      })),
    });
    presses.reconcile([done]);
    expect(points()).toEqual(['done', 'done', 'done', 'done']);
    expect(stepsOf(seen.presses[0] as Press)[3]?.at).toBe('2026-12-01T18:42:08Z');
    expect(headlineOf(seen.presses[0] as Press).word).toBe('ABORT completed');
  });
  it('does not search the history for a press that the server refused', async () => {
    const { presses, seen, pass } = rig([refused(409, 'the line is down')]);
    void presses.press();
    await pass(0);
    void presses.check();
    await pass(0);
    expect(seen.presses[0]?.notInHistory).toBe(false);
  });
  it('keeps the newer report if the response arrives after it', async () => {
    const { presses, seen, pass } = rig([command({ result: 'queued' })]);
    void presses.press();
    presses.reconcile([command({ result: 'completed' })]);
    await pass(0);
    expect(seen.presses[0]?.command?.result).toBe('completed');
  });
  it('is followed by its request id if the server records it after the response', async () => {
    const { presses, seen, pass } = rig([receipt(null)]);
    void presses.press();
    await pass(0);
    expect(seen.presses[0]?.fate).toBe('taken');
    presses.reconcile([command({ id: 8, request_id: 22 }), command({ id: 9, result: 'completed' })]);
    expect(seen.presses[0]).toMatchObject({ fate: 'recorded', command: { id: 9 } });
  });
  it('is unknown, and not "not sent", when the server queued it and cannot record it', async () => {
    const { presses, seen, pass } = rig([receipt(null)]);
    void presses.press();
    await pass(RECORD_MS + 1);
    expect(seen.presses[0]).toMatchObject({
      fate: 'unknown',
      reason: 'the server queued ABORT for the line (#23) and has not recorded it',
    });
  });
  it('keeps an earlier press that was not sent while a later one completes', async () => {
    const { presses, seen, pass } = rig([UNREACHABLE()], { online: false });
    void presses.press();
    await pass(WINDOW_MS);
    void presses.press();
    await pass(WINDOW_MS);
    expect(seen.presses.map((p) => p.fate)).toEqual(['not_sent', 'not_sent']);
  });
});

const shown = (seen: { presses: readonly Press[] }): Press => seen.presses[0] as Press;

describe('the record of a press', () => {
  const LATE = command({ id: 9, created: '2026-12-01T18:43:00Z', result: 'completed' });
  it('is found by its request id, however late the server stored it', async () => {
    const { presses, seen, pass } = rig([receipt(null)]);
    void presses.press();
    await pass(RECORD_MS + 1);
    presses.reconcile([
      { ...LATE, user: 'lee' },
      { ...LATE, request_id: 24 },
    ]);
    expect(shown(seen).fate).toBe('unknown');
    presses.reconcile([LATE]);
    expect(shown(seen)).toMatchObject({ fate: 'recorded', command: { id: 9 } });
  });
  it('is searched by its request id until now', async () => {
    const { presses, seen, pass, world } = rig([receipt(null)]);
    void presses.press();
    await pass(90_000);
    world.history = [LATE];
    void presses.check();
    await pass(0);
    expect(shown(seen)).toMatchObject({ fate: 'recorded', command: { id: 9 } });
  });
  it('is needed before the strip says sent: the server has only queued ABORT for the line', async () => {
    const { presses, seen, pass } = rig([receipt(null)]);
    void presses.press();
    await pass(0);
    expect(headlineOf(shown(seen))).toEqual({
      word: 'ABORT is queued for the line',
      text: 'The server has queued it for the line (#23) and has not recorded it yet.',
      level: 'progress',
    });
    expect(stepsOf(shown(seen))[1]).toEqual({ name: 'sent', point: 'now', at: null });
    const queued = command({
      result: 'queued',
      stages: [{ name: 'queued', state: 'passed', at: '2026-12-01T18:42:07.100Z' }],
    });
    presses.reconcile([queued]);
    expect(headlineOf(shown(seen)).word).toBe('ABORT is queued for the line');
    expect(stepsOf(shown(seen))[1]).toEqual({ name: 'sent', point: 'now', at: null });
    presses.reconcile([command()]);
    expect(headlineOf(shown(seen)).word).toBe('ABORT sent');
    expect(stepsOf(shown(seen))[1]).toMatchObject({ name: 'sent', point: 'done' });
  });
});

describe('a browser without storage', () => {
  it('posts ABORT and follows it', async () => {
    const { presses, seen, pass } = rig([command()], { storage: new Error('QuotaExceededError') });
    void presses.press();
    await pass(0);
    expect(seen.posts).toBe(1);
    expect(shown(seen)).toMatchObject({ fate: 'recorded' });
    presses.acknowledge();
  });
});

describe('"not sent" is said only of what cannot have left', () => {
  it('is unknown when the stream was down and the server answered a probe', async () => {
    const { presses, seen, pass } = rig([UNREACHABLE()], { online: false, reachable: true });
    void presses.press();
    await pass(WINDOW_MS);
    expect(shown(seen).fate).toBe('unknown');
  });
  it('is unknown when the server was reachable in one part of the window', async () => {
    const { presses, seen, pass, world } = rig([UNREACHABLE()], { online: false, reachable: true });
    void presses.press();
    await pass(100);
    world.reachable = false;
    await pass(WINDOW_MS);
    expect(shown(seen).fate).toBe('unknown');
  });
  it('is unknown if a probe had no result', async () => {
    const { presses, seen, pass } = rig([UNREACHABLE()], { online: false, reachable: 'hang' });
    void presses.press();
    await pass(WINDOW_MS);
    expect(shown(seen).fate).toBe('unknown');
  });
  it('is unknown if an earlier attempt may have left before the server refused a later one', async () => {
    const { presses, seen, pass } = rig([UNREACHABLE(), refused(409, 'the line is down')], { online: true });
    void presses.press();
    await pass(1000);
    expect(shown(seen)).toMatchObject({ fate: 'unknown', answered: false });
    expect(shown(seen).reason).toBe(
      'an earlier attempt broke before the server answered; the server answered 409: the line is down',
    );
  });
  it('is not sent if the server refused the first attempt that reached it', async () => {
    const { presses, seen, pass, world } = rig([UNREACHABLE(), refused(409, 'the line is down')], { online: false });
    void presses.press();
    await pass(100);
    world.reachable = true;
    await pass(1000);
    expect(shown(seen)).toMatchObject({ fate: 'not_sent', answered: true, tries: 2 });
  });
});

describe('the search of the command history', () => {
  const LATE = command({ id: 9, created: '2026-12-01T18:42:08Z', result: 'completed' });
  async function unanswered() {
    const made = rig([UNREACHABLE()]);
    void made.presses.press();
    await made.pass(WINDOW_MS);
    void made.presses.check();
    await made.pass(0);
    return made;
  }
  it('is repeated until the press is a minute old before it reports none', async () => {
    const { seen, pass } = await unanswered();
    await pass(SEARCH_UNTIL_MS - WINDOW_MS - 100);
    expect(seen.searches).toBeGreaterThan(10);
    expect(shown(seen).notInHistory).toBe(false);
    await pass(SEARCH_EVERY_MS + 100);
    expect(shown(seen).notInHistory).toBe(true);
    const searches = seen.searches;
    await pass(600_000);
    expect(seen.searches).toBe(searches);
  });
  it('finds a late record', async () => {
    const { seen, pass, world } = await unanswered();
    await pass(30_000);
    world.history = [LATE];
    await pass(SEARCH_EVERY_MS);
    expect(shown(seen)).toMatchObject({ fate: 'recorded', command: { id: 9 } });
  });
  it.each([
    ['fails', refused(503, 'the server is busy')],
    ['has no answer', 'hang'],
  ] as const)('is repeated when it %s, also when the press is older', async (_, answer) => {
    const { seen, pass, world } = await unanswered();
    world.history = answer;
    await pass(300_000);
    expect(shown(seen).notInHistory).toBe(false);
    world.history = [LATE];
    await pass(3 * SEARCH_EVERY_MS);
    expect(shown(seen)).toMatchObject({ fate: 'recorded', command: { id: 9 } });
  });
  it('runs one search at a time and pauses while the server is unreachable', async () => {
    const { presses, seen, pass, world } = await unanswered();
    void presses.check();
    await pass(0);
    expect(seen.searches).toBe(1);
    world.online = false;
    await pass(30_000);
    expect(seen.searches).toBe(1);
    world.online = true;
    void presses.check();
    await pass(0);
    expect(seen.searches).toBe(2);
  });
});

describe('many presses', () => {
  it('that need the operator are all kept until acknowledged', async () => {
    const { presses, seen, pass } = rig([refused(409, 'the line is down')]);
    for (let i = 0; i < 30; i += 1) {
      void presses.press();
      await pass(10);
    }
    expect(seen.presses).toHaveLength(30);
    expect(JSON.parse(seen.saved)).toHaveLength(30);
    presses.acknowledge();
    expect(seen.presses).toEqual([]);
  });
  it('that completed are removed for the next one', async () => {
    const { presses, seen, pass } = rig([command({ result: 'completed' })]);
    void presses.press();
    await pass(10);
    void presses.press();
    await pass(10);
    expect(seen.presses).toHaveLength(1);
  });
});

import { describe, expect, it } from 'vitest';
import { RECORD_MS, SEARCH_EVERY_MS, SEARCH_UNTIL_MS, WINDOW_MS } from './abort';
import { headlineOf, stepsOf } from './abortPress';
import { command, receipt, refused, rig, shown, UNREACHABLE } from './abortTestRig';

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

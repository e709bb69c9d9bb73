import { describe, expect, it } from 'vitest';
import { answerOf, RECORD_MS, WINDOW_MS } from './abort';
import { headlineOf, stepsOf, type Press } from './abortPress';
import { command, FIRST_START, receipt, refused, rig, shown, UNREACHABLE } from './abortTestRig';

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
  it('is sent again to a server that has started since, within the window', async () => {
    const restarted = refused(412, 'the server has started again', '2026-12-01T18:42:05.000Z');
    const { presses, seen, pass } = rig([restarted, command()]);
    void presses.press();
    await pass(100);
    expect(seen.servers).toEqual([FIRST_START, '2026-12-01T18:42:05.000Z']);
    expect(seen.presses[0]).toMatchObject({ fate: 'recorded' });
  });
  it('is not sent if the server rejects its own start again', async () => {
    const { presses, seen, pass } = rig([refused(412, 'the server has started again', FIRST_START)]);
    void presses.press();
    await pass(100);
    expect(seen.posts).toBe(1);
    expect(seen.presses[0]).toMatchObject({ fate: 'not_sent' });
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

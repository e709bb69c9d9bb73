import { describe, expect, it } from 'vitest';
import { Batch, MIN_BETWEEN_MS, MAX_HELD, TOGETHER_MS } from './batch';

function rig() {
  const log: string[] = [];
  const waits: { ms: number; run: () => void }[] = [];
  const tab = { hidden: false, nowMs: 0 };
  const batch = new Batch(
    {
      hidden: () => tab.hidden,
      later: (run, ms) => waits.push({ run, ms }),
      frame: (run) => {
        log.push('frame');
        run();
      },
      now: () => tab.nowMs,
    },
    () => log.push('reload'),
  );
  const pass = (): void => {
    const wait = waits.shift();
    if (!wait) return;
    tab.nowMs += wait.ms;
    wait.run();
  };
  return { log, waits, tab, batch, pass };
}

describe('messages of the stream', () => {
  it('are handled together and in order, at most four times a second', () => {
    const { log, waits, batch, pass } = rig();
    for (let i = 0; i < 50; i++) batch.add(() => log.push(`${i}`));
    expect(waits.map((w) => w.ms)).toEqual([TOGETHER_MS]);
    pass();
    expect(log).toEqual(['frame', ...Array.from({ length: 50 }, (_, i) => `${i}`)]);
    batch.add(() => log.push('next'));
    expect(waits.map((w) => w.ms)).toEqual([MIN_BETWEEN_MS]);
    pass();
    expect(log.slice(-2)).toEqual(['frame', 'next']);
  });

  it('wait while the tab is hidden and are handled when it is shown', () => {
    const { log, waits, tab, batch, pass } = rig();
    tab.hidden = true;
    batch.add(() => log.push('a'));
    expect(waits).toEqual([]);
    tab.hidden = false;
    batch.shown();
    pass();
    expect(log).toEqual(['frame', 'a']);
  });

  it('of a hidden tab are handled before the state is loaded', () => {
    const { log, tab, batch, pass } = rig();
    tab.hidden = true;
    batch.add(() => log.push('old'));
    batch.drain();
    log.push('load');
    tab.hidden = false;
    batch.shown();
    pass();
    expect(log).toEqual(['old', 'load']);
  });

  it('are not kept without limit: a tab hidden for long reloads the state', () => {
    const { log, tab, batch, pass } = rig();
    batch.add(() => log.push('before'));
    tab.hidden = true;
    pass();
    for (let i = 0; i < 3 * MAX_HELD; i++) batch.add(() => log.push('old'));
    tab.hidden = false;
    batch.shown();
    batch.add(() => log.push('new'));
    pass();
    expect(log).toEqual(['frame', 'reload', 'frame', 'new']);
  });
});

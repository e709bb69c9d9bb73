import { beforeEach, describe, expect, it, vi } from 'vitest';

type Alarm = { id: number; state: string; level: string; worst: string; shelved: boolean };
const alarm = (over: Partial<Alarm>): Alarm => ({
  id: 1,
  state: 'raised',
  level: 'warning',
  worst: 'warning',
  shelved: false,
  ...over,
});

describe('the sound of alarms', () => {
  let stored: Map<string, string>;
  beforeEach(() => {
    stored = new Map();
    vi.stubGlobal('localStorage', { getItem: () => null, setItem: () => undefined });
  });
  async function sound(play: () => void) {
    const { AlarmSound } = await import('./alarmSound.svelte');
    return new AlarmSound(
      { getItem: (k) => stored.get(k) ?? null, setItem: (k, v) => void stored.set(k, v) },
      play,
    ) as unknown as { on: boolean; toggle: () => void; follow: (alarms: Alarm[]) => void };
  }
  it('is off until it is switched on, and is remembered', async () => {
    const play = vi.fn();
    const first = await sound(play);
    first.follow([]);
    first.follow([alarm({})]);
    expect([first.on, play.mock.calls.length]).toEqual([false, 0]);
    first.toggle();
    expect(play).toHaveBeenCalledTimes(1);
    expect((await sound(play)).on).toBe(true);
  });
  it('is played once for a new warning and again when it becomes critical', async () => {
    const play = vi.fn();
    stored.set('gss-alarm-sound', 'on');
    const s = await sound(play);
    s.follow([alarm({ id: 7 })]);
    expect(play).not.toHaveBeenCalled();
    s.follow([alarm({ id: 7 }), alarm({ id: 8 })]);
    s.follow([alarm({ id: 7 }), alarm({ id: 8 })]);
    expect(play).toHaveBeenCalledTimes(1);
    s.follow([alarm({ id: 7 }), alarm({ id: 8, level: 'critical', worst: 'critical' })]);
    expect(play).toHaveBeenCalledTimes(2);
  });
  it('is not played for a watch, or for acknowledged and shelved alarms', async () => {
    const play = vi.fn();
    stored.set('gss-alarm-sound', 'on');
    const s = await sound(play);
    s.follow([]);
    s.follow([
      alarm({ level: 'watch', worst: 'watch' }),
      alarm({ id: 2, state: 'acked' }),
      alarm({ id: 3, shelved: true }),
    ]);
    expect(play).not.toHaveBeenCalled();
  });
});

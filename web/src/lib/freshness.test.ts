import { describe, expect, it } from 'vitest';
import { cycleOf, exposureOf, freshnessOf, lampWhen, noteOf, sourceOf, type Conditions } from './freshness';

const NOW = Date.parse('2026-12-01T18:42:07Z');
const conditions = (over: Partial<Conditions> = {}): Conditions => ({
  nowMs: NOW,
  online: true,
  serverMs: NOW - 400,
  lineOpen: true,
  deviceMs: NOW - 600,
  ...over,
});

describe('age of a frame', () => {
  it('counts from the exposure, also for a frame that has just arrived', () => {
    expect(exposureOf(NOW - 9_000, conditions())).toMatchObject({ live: true, words: 'live, exposed 9.0 s ago' });
  });
  it('is not live when it is old, or when the device does not report', () => {
    expect(exposureOf(NOW - 31_000, conditions())).toMatchObject({ live: false, recent: false });
    expect(exposureOf(NOW - 9_000, conditions({ lineOpen: false })).words).toBe('exposed 9.0 s ago');
    expect(exposureOf(NOW - 9_000, conditions({ online: false })).live).toBe(false);
  });
  it('is not stated for an exposure after the time of the server', () => {
    expect(exposureOf(NOW + 60_000, conditions())).toMatchObject({
      live: false,
      words: 'exposure time is later than server time',
    });
  });
});

describe('freshness of a source', () => {
  it('changes from fresh to ageing to stale with the age of the last report', () => {
    const at = (ageS: number): string => freshnessOf('device', conditions({ deviceMs: NOW - ageS * 1000 }));
    expect([0, 3, 3.1, 10, 10.1].map(at)).toEqual(['fresh', 'fresh', 'ageing', 'ageing', 'stale']);
  });
  it('is offline for server and device when the event stream is lost, however recent the last report', () => {
    const c = conditions({ online: false });
    expect([freshnessOf('server', c), freshnessOf('device', c)]).toEqual(['offline', 'offline']);
  });
  it('is unknown for the device when the line is closed, and the server stays fresh', () => {
    const c = conditions({ lineOpen: false });
    expect([freshnessOf('server', c), freshnessOf('device', c)]).toEqual(['fresh', 'unknown']);
  });
  it('is unknown if nothing was ever reported', () => {
    expect(freshnessOf('device', conditions({ deviceMs: null }))).toBe('unknown');
    expect(freshnessOf('server', conditions({ serverMs: null }))).toBe('unknown');
  });
  it('treats an open stream without messages as a lost server', () => {
    const c = conditions({ serverMs: NOW - 11_000 });
    expect([freshnessOf('server', c), freshnessOf('device', c)]).toEqual(['stale', 'stale']);
  });
  it('prefers the time of the value over that of the last packet', () => {
    expect(freshnessOf('device', conditions(), NOW - 60_000)).toBe('stale');
  });
  it('never ages a record or a choice of the page', () => {
    const c = conditions({ online: false });
    expect([freshnessOf('record', c), freshnessOf('page', c)]).toEqual(['fresh', 'fresh']);
  });
});

describe('the lamp', () => {
  it('is never green, amber or red without a current report', () => {
    for (const freshness of ['stale', 'offline', 'unknown'] as const)
      expect(
        (['ok', 'watch', 'warning', 'critical', 'progress', 'stale'] as const).map((s) => lampWhen(s, freshness)),
      ).toEqual(Array(6).fill('unreported'));
    expect(lampWhen('ok', 'ageing')).toBe('ok');
  });
  it('does not change lamps that make no claim', () => {
    expect([lampWhen('never', 'offline'), lampWhen('off', 'offline')]).toEqual(['never', 'off']);
  });
  it('treats work in progress as a report of the server, and ended work as a record', () => {
    expect([sourceOf('progress', 'record'), sourceOf('ok', 'record'), sourceOf('progress', 'page')]).toEqual([
      'server',
      'record',
      'page',
    ]);
  });
});

describe('the note', () => {
  it('states when the value was last reported, with the day if it was not today', () => {
    expect(noteOf('fresh', NOW, NOW)).toBe('');
    expect(noteOf('ageing', NOW - 4000, NOW)).toBe('4.0 s ago');
    expect(noteOf('offline', NOW - 17_000, NOW)).toBe('last reported 18:41:50Z');
    expect(noteOf('unknown', NOW - 86_400_000, NOW)).toBe('last reported 2026-11-30 18:42:07Z');
    expect(noteOf('unknown', null, NOW)).toBe('never reported');
  });
});

describe('the cycle', () => {
  it('is unknown, not stopped, after the port is lost', () => {
    const cycle = cycleOf(true, NOW - 15_000, conditions({ lineOpen: false }));
    expect(cycle).toEqual({ running: null, last: true, words: 'unknown, last reported running 18:41:52Z' });
  });
  it('is what the device reports while it reports', () => {
    expect(cycleOf(true, NOW - 900, conditions()).words).toBe('running');
    expect(cycleOf(false, NOW - 900, conditions()).running).toBe(false);
  });
  it('is unknown before the first report', () => {
    expect(cycleOf(null, null, conditions()).words).toBe('unknown, never reported');
  });
});

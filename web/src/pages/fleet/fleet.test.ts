import { describe, expect, it } from 'vitest';
import type { FleetUnit } from '../../api/types';
import { alarmOf, attitudeOf, bankOf, lineOf, passOf, processOf } from './fleet';

const link = {
  connected: true,
  reason: '',
  rx: { state: 'up', age_s: 0.4, bytes: 900 },
  alarms: [],
  attitude: { ra_deg: 12.5, dec_deg: -3, sigma_cross_arcsec: 2.04, age_s: 1, newest_outcome: 'solved' },
  active_bank: { bank: 'A', catalogue_name: 'night', days_left: 0.5 },
} as unknown as NonNullable<FleetUnit['link']>;
const unit: FleetUnit = {
  name: 'FM1',
  instrument: 'cubestar',
  address: '/dev/ttyUSB0',
  process: 'running',
  restarts: 0,
  last_end: '',
  reason: '',
  process_age_s: 60,
  link,
  age_s: 0.5,
  current: true,
};

describe('the fleet', () => {
  it('says what a unit reports', () => {
    expect(processOf(unit)).toEqual({ state: 'ok', word: 'running' });
    expect(lineOf(unit).word).toBe('up, received 0.4 s ago');
    expect(alarmOf(unit)).toEqual({ state: 'ok', word: 'none' });
    expect(attitudeOf(unit)).toEqual({ state: 'ok', word: '12.500° −3.000° ± 2.0″, 1.5 s ago' });
    expect(bankOf(unit)).toEqual({ state: 'warning', word: 'A: night, 12 h left' });
  });
  it('distinguishes invalid bytes from silence', () => {
    const word = (bytes: number): string =>
      lineOf({ ...unit, link: { ...link, rx: { ...link.rx, state: 'down', age_s: null, bytes } } }).word;
    expect(word(0)).toBe('down, nothing received');
    expect(word(512)).toBe('down, no valid packet');
  });
  it('claims nothing of a unit that is silent', () => {
    const silent: FleetUnit = { ...unit, current: false, age_s: 12, process: 'ended', last_end: 'signal 9' };
    expect(processOf(silent)).toEqual({
      state: 'critical',
      word: 'restarting, ended by signal 9; last report 12 s ago',
    });
    for (const of of [lineOf, alarmOf, bankOf]) expect(of(silent).state).toBe('unknown');
    expect(attitudeOf(silent)).toEqual({ state: 'unknown', word: '12.500° −3.000° ± 2.0″, 13 s ago' });
    expect(processOf({ ...silent, reason: 'another GSS server uses this data folder' }).word).toBe(
      'cannot start: another GSS server uses this data folder',
    );
  });
  it('says since when a process starts, and marks one that may hang', () => {
    const start = { ...unit, current: false, age_s: null, process: 'starting' as const };
    expect(processOf({ ...start, process_age_s: 40 })).toEqual({
      state: 'unknown',
      word: 'starting, started 40 s ago; no report yet',
    });
    expect(processOf({ ...start, process_age_s: 300 })).toEqual({
      state: 'warning',
      word: 'no recent report, started 5 min 0 s ago; no report yet',
    });
  });
  it('shows the next pass, one under way, and why there is none', () => {
    const at = Date.parse('2026-11-25T12:00:00Z');
    const next_pass = {
      station: 'Cape Town',
      rise: '2026-11-25T12:10:00Z',
      set: '2026-11-25T12:20:00Z',
      max_elevation_deg: 41.2,
      problem: '',
    };
    const seen: FleetUnit = { ...unit, link: { ...link, next_pass } };
    expect(passOf(seen, at)).toEqual({ state: 'off', word: 'Cape Town, in 10 min 0 s, max. elevation 41°' });
    expect(passOf(seen, at + 900_000)).toEqual({
      state: 'progress',
      word: 'Cape Town, sets in 5 min 0 s, max. elevation 41°',
    });
    const none = { station: null, rise: null, set: null, max_elevation_deg: null, problem: 'No orbit was imported.' };
    expect(passOf({ ...unit, link: { ...link, next_pass: none } }, at).word).toBe('No orbit was imported.');
    expect(passOf({ ...seen, current: false }, at).state).toBe('unknown');
  });
  it('names a newer report without a solution', () => {
    const lost = { ...link, attitude: { ...link.attitude!, newest_outcome: 'no_match' } };
    expect(attitudeOf({ ...unit, link: lost })).toEqual({
      state: 'watch',
      word: '12.500° −3.000° ± 2.0″, 1.5 s ago; newest: no match',
    });
  });
});

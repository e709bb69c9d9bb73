/**
 * How current an indicator is. Only this module decides it; docs/indicators.md lists every indicator with its source.
 * The source of an indicator is one of: `server` (command authority, open alarms, state of the port), `device` (mode,
 * cycle, banks, telemetry: known only through the line), `record` (an event that stays true, such as "completed
 * 14:02:11Z"; work in progress counts as `server`), `page` (a choice made on this page).
 */
import { clock, day, span } from './format';
import type { LampState } from './lamp';

export type Source = 'server' | 'device' | 'record' | 'page';
/**
 * `offline`: the server cannot be reached. `unknown`: never reported, or the line is closed and no report can arrive.
 */
export type Freshness = 'fresh' | 'ageing' | 'stale' | 'offline' | 'unknown';

/** Server and device both report once a second. */
export const AGEING_AFTER_MS = 3_000;
export const STALE_AFTER_MS = 10_000;

/** Times are UTC on the server's clock, in milliseconds. */
export interface Conditions {
  nowMs: number;
  /** Whether the event stream is connected. */
  online: boolean;
  /** When the server last reported its status. */
  serverMs: number | null;
  /** Whether the port to the device is open, as last reported. */
  lineOpen: boolean;
  /** When the last intact packet from the device arrived. */
  deviceMs: number | null;
}

function byAge(atMs: number | null, nowMs: number): Freshness {
  if (atMs === null) return 'unknown';
  const ageMs = nowMs - atMs;
  return ageMs > STALE_AFTER_MS ? 'stale' : ageMs > AGEING_AFTER_MS ? 'ageing' : 'fresh';
}

/** True if the indicator may be shown as the present state. */
export function isCurrent(freshness: Freshness): boolean {
  return freshness === 'fresh' || freshness === 'ageing';
}

/** Freshness of a source. `atMs`: when this value was last reported, if it has a separate time. */
export function freshnessOf(source: Source, c: Conditions, atMs: number | null = lastReport(source, c)): Freshness {
  if (source === 'record' || source === 'page') return 'fresh';
  if (!c.online) return 'offline';
  const server = byAge(c.serverMs, c.nowMs);
  if (source === 'server' || !isCurrent(server)) return server;
  return c.lineOpen ? byAge(atMs, c.nowMs) : 'unknown';
}

export function lastReport(source: Source, c: Conditions): number | null {
  return source === 'device' ? c.deviceMs : c.serverMs;
}

/** The source that a lamp depends on: work in progress is valid only while the server reports it. */
export function sourceOf(state: LampState, source: Source): Source {
  return source === 'record' && state === 'progress' ? 'server' : source;
}

/**
 * The lamp to draw: a state that is not current is `unreported`, grey and hatched. A hollow or struck lamp makes no
 * claim and does not change.
 */
export function lampWhen(state: LampState, freshness: Freshness): LampState {
  return isCurrent(freshness) || state === 'never' || state === 'off' ? state : 'unreported';
}

/** "14:12:52Z", preceded by the day if it is not today. */
export function reportTime(atMs: number, nowMs: number): string {
  const [at, now] = [new Date(atMs).toISOString(), new Date(nowMs).toISOString()];
  return day(at) === day(now) ? clock(at) : `${day(at)} ${clock(at)}`;
}

/** The text beside the value: nothing while fresh, its age while ageing, then the time of the last report. */
export function noteOf(freshness: Freshness, atMs: number | null, nowMs: number): string {
  if (freshness === 'fresh') return '';
  if (atMs === null) return 'never reported';
  return freshness === 'ageing' ? `${span((nowMs - atMs) / 1000)} ago` : `last reported ${reportTime(atMs, nowMs)}`;
}

/** A frame exposed at most this long ago is labelled live. */
export const LIVE_FRAME_MS = 30_000;

/** The age of a frame since its exposure, however late it was received. `live`: recent, and the device reports. */
export function exposureOf(takenMs: number, c: Conditions): { live: boolean; recent: boolean; words: string } {
  const ageMs = c.nowMs - takenMs;
  if (ageMs < -AGEING_AFTER_MS) return { live: false, recent: false, words: 'exposed after the time of the server' };
  const recent = ageMs <= LIVE_FRAME_MS;
  const live = recent && isCurrent(freshnessOf('device', c));
  return { live, recent, words: `${live ? 'live, ' : ''}exposed ${span(Math.max(0, ageMs) / 1000)} ago` };
}

export interface Cycle {
  /** null: not known at present. */
  running: boolean | null;
  /** As last reported. */
  last: boolean | null;
  words: string;
}

/** The on-board cycle: a sensor continues its cycle without a link, so "stopped" is shown only while it is reported. */
export function cycleOf(last: boolean | null, atMs: number | null, c: Conditions): Cycle {
  const freshness = freshnessOf('device', c, atMs);
  const word = last ? 'running' : 'stopped';
  if (last !== null && isCurrent(freshness)) return { running: last, last, words: word };
  const words =
    last === null || atMs === null
      ? 'unknown, never reported'
      : `unknown, last reported ${word} ${reportTime(atMs, c.nowMs)}`;
  return { running: null, last, words };
}

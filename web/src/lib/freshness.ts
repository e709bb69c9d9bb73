/**
 * Freshness of indicators. Only this module decides whether an indicator is current; docs/indicators.md lists every
 * indicator with its source. Sources: `server` (command authority, open alarms, state of the port, work in progress),
 * `device` (mode, cycle, banks and telemetry, which only the line reports), `record` (a past event, such as "completed
 * 14:02:11Z"), `page` (a choice on this page).
 */
import { clock, day, span } from './format';
import type { LampState } from './lamp';

export type Source = 'server' | 'device' | 'record' | 'page';
/**
 * Source of a lamp. `housekeeping`: a state that only the housekeeping of the device reports. It is not current if
 * housekeeping is missing while other packets arrive, for example during a long download.
 */
export type LampSource = Source | 'housekeeping';
/**
 * `offline`: the server cannot be reached. `unknown`: never reported, or the line is closed and no report can arrive.
 */
export type Freshness = 'fresh' | 'ageing' | 'stale' | 'offline' | 'unknown';

/** Limits of the ages. Server and device each report once per second. */
export const AGEING_AFTER_MS = 3_000;
export const STALE_AFTER_MS = 10_000;

/** Times are UTC on the server's clock, in milliseconds. */
export interface Conditions {
  nowMs: number;
  /** True if the event stream is connected. */
  online: boolean;
  /** Time of the server's last status report. */
  serverMs: number | null;
  /** True if the port to the device was open in the last report. */
  lineOpen: boolean;
  /** Arrival time of the last intact packet from the device. */
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

/** Return the freshness of a source. `atMs`: time of the value's last report, if it differs from that of the source. */
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

/** Return the source on which a lamp depends: work in progress is valid only while the server reports it. */
export function sourceOf<S extends LampSource>(state: LampState, source: S): S | 'server' {
  return source === 'record' && state === 'progress' ? 'server' : source;
}

/**
 * Return the lamp to draw. A state that is not current becomes `unreported`, grey and hatched. The lamps `never` and
 * `off` assert no state and do not change.
 */
export function lampWhen(state: LampState, freshness: Freshness): LampState {
  return isCurrent(freshness) || state === 'never' || state === 'off' ? state : 'unreported';
}

/** Format the time of a report: "14:12:52Z", preceded by the date if it is not today. */
export function reportTime(atMs: number, nowMs: number): string {
  const [at, now] = [new Date(atMs).toISOString(), new Date(nowMs).toISOString()];
  return day(at) === day(now) ? clock(at) : `${day(at)} ${clock(at)}`;
}

/** Return the text beside a value: empty while fresh, its age while ageing, then the time of the last report. */
export function noteOf(freshness: Freshness, atMs: number | null, nowMs: number): string {
  if (freshness === 'fresh') return '';
  if (atMs === null) return 'never reported';
  return freshness === 'ageing' ? `${span((nowMs - atMs) / 1000)} ago` : `last reported ${reportTime(atMs, nowMs)}`;
}

/** Maximum age of a frame that is labelled live. */
export const LIVE_FRAME_MS = 30_000;

/**
 * Return the age of a frame since its exposure, even if it was received late. `live`: the frame is recent and the
 * device reports.
 */
export function exposureOf(takenMs: number, c: Conditions): { live: boolean; recent: boolean; words: string } {
  const ageMs = c.nowMs - takenMs;
  if (ageMs < -AGEING_AFTER_MS) return { live: false, recent: false, words: 'exposure time is later than server time' };
  const recent = ageMs <= LIVE_FRAME_MS;
  const live = recent && isCurrent(freshnessOf('device', c));
  return { live, recent, words: `${live ? 'live, ' : ''}exposed ${span(Math.max(0, ageMs) / 1000)} ago` };
}

export interface Cycle {
  /** Null if unknown at present. */
  running: boolean | null;
  /** As last reported. */
  last: boolean | null;
  words: string;
}

/**
 * Return the state of the on-board cycle. The sensor continues its cycle without a link, so the page shows "stopped"
 * only while the device reports it.
 */
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

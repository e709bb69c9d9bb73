/** Cells of a unit on the Fleet page: process, line, alarms, attitude, next pass and active bank. */
import type { FleetUnit } from '../../api/types';
import { expiryOf } from '../../lib/banks';
import { degrees, fixed, span } from '../../lib/format';
import { lampOf, type LampState } from '../../lib/lamp';

/** Time in which a process has reported on a busy machine. A process without a report after this time may hang. */
const SLOW_START_S = 120;

export interface Cell {
  state: LampState;
  word: string;
}

/**
 * Return the state of a unit's process. If the unit does not report at present, the text states why its process cannot
 * start, or the cause of its last end and the age of its last report.
 */
export function processOf(u: FleetUnit): Cell {
  if (u.current) return { state: 'ok', word: 'running' };
  const last = u.age_s === null ? 'no report yet' : `last report ${span(u.age_s)} ago`;
  if (u.reason) return { state: 'critical', word: `cannot start: ${u.reason}` };
  const cause = u.last_end ? `, ended by ${u.last_end}` : '';
  if (u.process === 'ended') return { state: 'critical', word: `restarting${cause}; ${last}` };
  const started = u.process_age_s === null ? '' : `, started ${span(u.process_age_s)} ago`;
  const late = (u.process_age_s ?? 0) > SLOW_START_S;
  return {
    state: late ? 'warning' : 'unknown',
    word: `${u.age_s === null && !late ? 'starting' : 'no recent report'}${started}${cause}; ${last}`,
  };
}

export function lineOf(u: FleetUnit): Cell {
  if (!u.current || !u.link) return { state: 'unknown', word: 'unknown' };
  if (!u.link.connected) return { state: 'warning', word: u.link.reason || 'closed' };
  const { state, age_s, bytes } = u.link.rx;
  const never = bytes ? 'no valid packet' : 'nothing received';
  const received = age_s === null ? never : `received ${span(age_s)} ago`;
  return { state: state === 'up' ? 'ok' : state === 'noisy' ? 'watch' : 'warning', word: `${state}, ${received}` };
}

export function alarmOf(u: FleetUnit): Cell {
  if (!u.current || !u.link) return { state: 'unknown', word: 'unknown' };
  const worst = u.link.alarms[0];
  if (!worst) return { state: 'ok', word: 'none' };
  const more = u.link.alarms.length - 1;
  return { state: lampOf(worst.level), word: `${worst.text}${more ? `, and ${fixed(more)} more` : ''}` };
}

export function attitudeOf(u: FleetUnit): Cell {
  const a = u.link?.attitude;
  if (!a) return { state: 'never', word: u.current ? 'none reported' : 'unknown' };
  const age = a.age_s + (u.age_s ?? 0);
  const sigma = a.sigma_cross_arcsec === null ? '' : ` ± ${fixed(a.sigma_cross_arcsec, 1)}″`;
  const lost = a.newest_outcome === 'solved' ? '' : `; newest: ${a.newest_outcome.replace(/_/g, ' ')}`;
  const state: LampState = !u.current ? 'unknown' : lost ? 'watch' : 'ok';
  return { state, word: `${degrees(a.ra_deg, 3)} ${degrees(a.dec_deg, 3, true)}${sigma}, ${span(age)} ago${lost}` };
}

/** Return the next pass, or the reason why it is unknown. */
export function passOf(u: FleetUnit, nowMs: number): Cell {
  const pass = u.link?.next_pass;
  if (!pass || !u.current) return { state: 'unknown', word: 'unknown' };
  if (!pass.rise || !pass.set) return { state: 'never', word: pass.problem };
  const [rise, set] = [Date.parse(pass.rise), Date.parse(pass.set)];
  const top = pass.max_elevation_deg === null ? '' : `, max. elevation ${degrees(pass.max_elevation_deg, 0)}`;
  if (rise <= nowMs) return { state: 'progress', word: `${pass.station}, sets in ${span((set - nowMs) / 1000)}${top}` };
  return { state: 'off', word: `${pass.station}, in ${span((rise - nowMs) / 1000)}${top}` };
}

export function bankOf(u: FleetUnit): Cell {
  if (!u.current || !u.link) return { state: 'unknown', word: 'unknown' };
  const bank = u.link.active_bank;
  if (!bank) return { state: 'never', word: 'none reported' };
  const { state, word } = expiryOf(bank);
  return { state, word: `${bank.bank}: ${bank.catalogue_name ?? 'not in this store'}, ${word}` };
}

/**
 * Order of the open alarms in the header, the sidebar and Monitor: most severe first, then unacknowledged first, then
 * oldest first; shelved alarms are last. An unacknowledged alarm keeps its worst level, because it latches.
 */
import type { AlarmRow, Link } from '../api/types';
import type { LampState } from './lamp';
import { lampOf } from './lamp';

type OpenAlarm = Pick<
  AlarmRow,
  'id' | 'packet' | 'field' | 'state' | 'level' | 'worst' | 'shelved' | 'raised' | 'text'
>;
type Condition = Link['alarms'][number];
const RANK = ['critical', 'warning', 'watch', 'unknown', 'ok'];
const rank = (level: string): number => (RANK.indexOf(level) + 1 || RANK.length + 1) - 1;

/** True if the value is normal again. A device event has no end: its alarm remains until it is acknowledged. */
export function isBack(a: Pick<AlarmRow, 'packet' | 'state'>): boolean {
  return a.state === 'closed' || (a.state === 'cleared' && a.packet !== 'event');
}

export const levelOf = (a: Pick<OpenAlarm, 'state' | 'level' | 'worst'>): AlarmRow['level'] =>
  a.state === 'acked' ? a.level : a.worst;

export function byUrgency<A extends OpenAlarm>(list: readonly A[]): A[] {
  return [...list].sort(
    (a, b) =>
      Number(a.shelved) - Number(b.shelved) ||
      rank(levelOf(a)) - rank(levelOf(b)) ||
      Number(a.state === 'acked') - Number(b.state === 'acked') ||
      Number(isBack(a)) - Number(isBack(b)) ||
      Date.parse(a.raised) - Date.parse(b.raised) ||
      a.id - b.id,
  );
}

/** Return the lamp of the most urgent open alarm; undefined if every alarm is shelved. */
export function lampOfAlarms(list: readonly OpenAlarm[]): LampState | undefined {
  const first = byUrgency(list)[0];
  return first && !first.shelved ? lampOf(levelOf(first)) : undefined;
}

/**
 * Return what the link reports without an alarm row: conditions, which end automatically and cannot be acknowledged,
 * and alarms whose row is not loaded.
 */
export function conditions(reported: readonly Condition[], rows: readonly OpenAlarm[]): Condition[] {
  const withRow = new Set(rows.map((a) => `alarm-${a.id}`));
  if (rows.some((a) => a.packet === 'link' && a.field === 'housekeeping' && a.state !== 'cleared'))
    withRow.add('silent');
  return reported.filter((c) => !withRow.has(c.id));
}

export interface HeaderAlarm {
  /** Null for what the link reports without an alarm row. */
  id: number | null;
  level: string;
  text: string;
}

/** Return all open alarms that are not shelved, most severe first. */
export function headerAlarms(reported: readonly Condition[], rows: readonly OpenAlarm[]): HeaderAlarm[] {
  const alarms = byUrgency(rows.filter((a) => !a.shelved));
  return [
    ...alarms.map((a) => ({ id: a.id, level: levelOf(a), text: a.text })),
    ...conditions(reported, rows).map((c) => ({ id: null, level: c.level, text: c.text })),
  ].sort((a, b) => rank(a.level) - rank(b.level));
}

/**
 * Convert "Cleared, not acknowledged: X" to "X, cleared, not acknowledged". The subject comes first, because
 * the header can show only the start of a very long text.
 */
export function subjectFirst(text: string): string {
  const parts = /^(Cleared, not acknowledged|Acknowledged): (.+)$/.exec(text);
  return parts ? `${parts[2]}, ${parts[1]?.toLowerCase()}` : text;
}

/** Remove the level from the text of an alarm ("above 65 (critical)"), for places that show it beside the text. */
export function withoutLevel(text: string, level: string): string {
  return text.replace(` (${level})`, '');
}

/** Half the span of an alarm's plot: five minutes before and after the alarm, but not beyond the present time. */
export const AROUND_MS = 300_000;

export function spanAround(raised: string, nowMs: number): { from: string; to: string } {
  const at = Date.parse(raised);
  const [from, to] = [at - AROUND_MS, Math.min(nowMs, at + AROUND_MS)];
  return { from: new Date(from).toISOString(), to: new Date(Math.max(to, from + 1000)).toISOString() };
}

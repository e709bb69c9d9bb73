/**
 * The list of open alarms, shared by header, sidebar and Monitor. Ordered by severity, then unacknowledged first, then
 * oldest first; shelved ones are last. An unacknowledged alarm counts with its worst level, because it latches.
 */
import type { AlarmRow, Link } from '../api/types';
import type { LampState } from './lamp';
import { lampOf } from './lamp';

type Known = Pick<AlarmRow, 'id' | 'packet' | 'field' | 'state' | 'level' | 'worst' | 'shelved' | 'raised' | 'text'>;
type Condition = Link['alarms'][number];
const RANK = ['critical', 'warning', 'watch', 'unknown', 'ok'];
const rank = (level: string): number => (RANK.indexOf(level) + 1 || RANK.length + 1) - 1;

/** The value is normal again. An event of the device has no end: it remains until it is acknowledged. */
export function isBack(a: Pick<AlarmRow, 'packet' | 'state'>): boolean {
  return a.state === 'closed' || (a.state === 'cleared' && a.packet !== 'event');
}

export const levelOf = (a: Pick<Known, 'state' | 'level' | 'worst'>): AlarmRow['level'] =>
  a.state === 'acked' ? a.level : a.worst;

export function byUrgency<A extends Known>(list: readonly A[]): A[] {
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

/** The lamp of the most urgent open alarm; none where every one is shelved. */
export function lampOfAlarms(list: readonly Known[]): LampState | undefined {
  const first = byUrgency(list)[0];
  return first && !first.shelved ? lampOf(levelOf(first)) : undefined;
}

/** Conditions of the link without a database row: they end automatically and cannot be acknowledged. */
export function conditions(reported: readonly Condition[], rows: readonly Known[]): Condition[] {
  const silenceHasRow = rows.some((a) => a.packet === 'link' && a.field === 'housekeeping' && a.state !== 'cleared');
  return reported.filter((c) => !c.id.startsWith('alarm-') && !(c.id === 'silent' && silenceHasRow));
}

export interface HeaderAlarm {
  /** null: a condition of the link, without a row. */
  id: number | null;
  level: string;
  text: string;
}

/** All open alarms that are not shelved, most severe first. */
export function headerAlarms(reported: readonly Condition[], rows: readonly Known[]): HeaderAlarm[] {
  const alarms = byUrgency(rows.filter((a) => !a.shelved));
  return [
    ...alarms.map((a) => ({ id: a.id, level: levelOf(a), text: a.text })),
    ...conditions(reported, rows).map((c) => ({ id: null, level: c.level, text: c.text })),
  ].sort((a, b) => rank(a.level) - rank(b.level));
}

/** "Cleared, not acknowledged: X" as "X, cleared, not acknowledged": the header may cut the end, not the subject. */
export function subjectFirst(text: string): string {
  const parts = /^(Cleared, not acknowledged|Acknowledged): (.+)$/.exec(text);
  return parts ? `${parts[2]}, ${parts[1]?.toLowerCase()}` : text;
}

/** The span of an alarm's plot: five minutes before it to five minutes after it, at most until now. */
export const AROUND_MS = 300_000;

export function spanAround(raised: string, nowMs: number): { from: string; to: string } {
  const at = Date.parse(raised);
  const [from, to] = [at - AROUND_MS, Math.min(nowMs, at + AROUND_MS)];
  return { from: new Date(from).toISOString(), to: new Date(Math.max(to, from + 1000)).toISOString() };
}

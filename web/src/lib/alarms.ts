/** Which alarm comes first: what is outside its limits now, by its level of the moment; then what is back; shelved ones last. */
import type { AlarmRow } from '../api/types';
import type { LampState } from './lamp';
import { lampOf } from './lamp';

type Known = Pick<AlarmRow, 'id' | 'packet' | 'state' | 'level' | 'worst' | 'shelved' | 'raised'>;
const RANK = ['critical', 'warning', 'watch', 'unknown', 'ok'];
const rank = (level: string): number => (RANK.indexOf(level) + 1 || RANK.length + 1) - 1;

/** Back to normal, though not yet seen. An event of the device has no way back: it stands until it is seen. */
export function isBack(a: Pick<AlarmRow, 'packet' | 'state'>): boolean {
  return a.state === 'closed' || (a.state === 'cleared' && a.packet !== 'event');
}

const levelOf = (a: Known): string => (a.state === 'raised' || a.state === 'acked' ? a.level : a.worst);
const turn = (a: Known): number => (a.shelved ? 2 : Number(isBack(a)));

export function byUrgency<A extends Known>(list: readonly A[]): A[] {
  return [...list].sort((a, b) => turn(a) - turn(b) || rank(levelOf(a)) - rank(levelOf(b)) || Date.parse(a.raised) - Date.parse(b.raised) || a.id - b.id);
}

/** The lamp of the most urgent open alarm; none where every one is shelved. */
export function lampOfAlarms(list: readonly Known[]): LampState | undefined {
  const first = byUrgency(list)[0];
  return first && !first.shelved ? lampOf(levelOf(first)) : undefined;
}

/** The header's own list in the same order: a line of it that belongs to an alarm now back to normal comes after the rest. */
export function headerOrder<L extends { id: string; level: string }>(lines: readonly L[], rows: readonly Known[]): L[] {
  const back = new Set(rows.filter(isBack).map((a) => `alarm-${a.id}`));
  return [...lines].sort((a, b) => Number(back.has(a.id)) - Number(back.has(b.id)) || rank(a.level) - rank(b.level));
}

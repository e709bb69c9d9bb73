/** Marks of the event lane. Commands and events whose marks would overlap have one mark with their number. */
import type { LampState } from '../../lib/lamp';
import type { Happening } from './happenings.svelte';

export interface EventMark {
  key: string;
  /** Position in pixels. */
  x: number;
  count: number;
  /** "event" if the mark contains an event. */
  kind: Happening['kind'];
  /** State of the most severe item. */
  state: LampState;
  /** Lines with all items. */
  text: string;
  /** Label: the number, if it is more than one, and the name of the most severe item. */
  label: string;
}
/** Width of a mark in pixels. */
const MARK_PX = 10;
const SEVERITY: readonly LampState[] = ['critical', 'warning', 'unknown', 'watch'];

/**
 * Return the marks of a list in order of time, at most one for `MARK_PX` pixels. `x` returns the position of a time in
 * pixels.
 */
export function eventMarks(list: readonly Happening[], x: (t: number) => number): EventMark[] {
  const groups: Happening[][] = [];
  for (const e of list) {
    const last = groups.at(-1);
    if (last?.[0] && x(e.t) - x(last[0].t) < MARK_PX) last.push(e);
    else groups.push([e]);
  }
  return groups.map((group) => markOf(group, x));
}

function markOf(group: readonly Happening[], x: (t: number) => number): EventMark {
  const worst = group.reduce((a, b) => (rank(b) < rank(a) ? b : a));
  return {
    key: group[0]?.key ?? '',
    x: x(group[0]?.t ?? 0),
    count: group.length,
    kind: group.some((e) => e.kind === 'event') ? 'event' : 'command',
    state: worst.state,
    text: group.map((e) => e.text).join('\n'),
    label: group.length > 1 ? `${group.length}: ${worst.short}` : worst.short,
  };
}

function rank(e: Happening): number {
  const at = SEVERITY.indexOf(e.state);
  return at < 0 ? SEVERITY.length : at;
}

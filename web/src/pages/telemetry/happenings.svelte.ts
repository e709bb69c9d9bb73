/** Commands and events of a period, for the lane above the plots and the details of an alarm. */
import { api } from '../../api/client';
import type { Command, EventRow } from '../../api/types';
import type { LampState } from '../../lib/lamp';
import { lampOf } from '../../lib/lamp';
import { resultState } from '../../lib/stages';

export interface Happening {
  key: string;
  t: number;
  kind: 'command' | 'event';
  text: string;
  short: string;
  state: LampState;
}

export function ofCommand(c: Command): Happening {
  const state = resultState(c);
  return {
    key: `c${c.id}`,
    t: Date.parse(c.created) / 1000,
    kind: 'command',
    text: `${c.created.slice(11, 19)}Z ${c.name} ${c.text}: ${c.result}`,
    short: c.name,
    state: state === 'progress' ? 'ok' : state,
  };
}

export function ofEvent(e: EventRow): Happening {
  const short = e.text.length > 26 ? `${e.text.slice(0, 25)}…` : e.text;
  return {
    key: `e${e.seq}`,
    t: Date.parse(e.at) / 1000,
    kind: 'event',
    text: `${e.at.slice(11, 19)}Z ${e.text}`,
    short,
    state: e.severity === 'info' ? 'ok' : lampOf(e.severity),
  };
}

/** True for events of the device and for abnormal events. Normal events of the server are not shown. */
const isShown = (e: EventRow): boolean => e.kind === 'device' || !['ok', 'info'].includes(e.severity);

export async function happened(start: string, end: string): Promise<Happening[]> {
  const [commands, events] = await Promise.all([api.findCommands({ start, end }), api.eventsOf(start, end)]);
  return [...commands.filter((c) => c.source !== 'server').map(ofCommand), ...events.filter(isShown).map(ofEvent)].sort(
    (a, b) => a.t - b.t,
  );
}

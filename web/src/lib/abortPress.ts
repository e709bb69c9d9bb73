/** State of one press of ABORT, and the steps and the text that the strip shows for it. */
import type { Command, Stage } from '../api/types';
import { sentence } from './sentence';

/**
 * State of a press. `sending`: the request is in progress. `taken`: the server queued ABORT for the line and has not
 * recorded it yet. `recorded`: the server has recorded the command and reports its stages.
 */
export type Fate = 'sending' | 'taken' | 'recorded' | 'not_sent' | 'unknown';
export interface Press {
  key: string;
  user: string;
  /** UTC of the server's clock, in milliseconds. */
  pressedMs: number;
  fate: Fate;
  reason: string;
  tries: number;
  /** Request id on the line; null until the server has queued ABORT. */
  requestId: number | null;
  command: Command | null;
  /** True if a search of the server's command history found no ABORT for this press. */
  notInHistory: boolean;
  /** True if the server answered with an error. */
  answered: boolean;
}

const BAD_ENDS = ['rejected', 'failed', 'unknown', 'resolved', 'withdrawn'];

/** True if the press has ended: no further report is expected. */
export function isOver(p: Press): boolean {
  return (
    p.fate === 'not_sent' ||
    p.fate === 'unknown' ||
    (p.command !== null && (p.command.result === 'completed' || BAD_ENDS.includes(p.command.result)))
  );
}

/** True if the server's history can still show the result of the press. */
export function isOpen(p: Press): boolean {
  return !p.notInHistory && (p.fate === 'unknown' || (p.fate === 'not_sent' && !p.answered));
}

/** True if the device completed this ABORT. */
export function isCompleted(p: Press): boolean {
  return p.command?.result === 'completed';
}

/** True if the strip must stay until it is acknowledged. */
export function needsOperator(p: Press): boolean {
  return isOver(p) && !isCompleted(p);
}

export type Point = 'done' | 'now' | 'failed' | 'unknown' | 'to_come';
export interface Step {
  name: 'pressed' | 'sent' | 'accepted' | 'completed';
  point: Point;
  at: string | null;
}

/** Return the steps that the strip shows: the press, and three of the command's seven stages. */
export function stepsOf(press: Press): Step[] {
  const pressed: Step = { name: 'pressed', point: 'done', at: new Date(press.pressedMs).toISOString() };
  const sent: Point =
    press.fate === 'sending' || press.fate === 'taken' ? 'now' : press.fate === 'not_sent' ? 'failed' : 'unknown';
  if (!press.command)
    return [
      pressed,
      { name: 'sent', point: sent, at: null },
      { name: 'accepted', point: 'to_come', at: null },
      { name: 'completed', point: 'to_come', at: null },
    ];
  const stages = new Map(press.command.stages.map((s) => [s.name, s]));
  const steps = (['sent', 'accepted', 'completed'] as const).map((name): Step => ({
    name,
    point: pointOf(stages.get(name)),
    at: stages.get(name)?.at ?? null,
  }));
  const next = steps.find((s) => s.point === 'to_come');
  if (next && !isOver(press) && !steps.some((s) => s.point === 'now')) next.point = 'now';
  const hasBadStep = steps.some((s) => s.point === 'failed' || s.point === 'unknown');
  if (next && isOver(press) && !hasBadStep) next.point = press.command.result === 'unknown' ? 'unknown' : 'failed';
  return [pressed, ...steps];
}

function pointOf(stage: Stage | undefined): Point {
  switch (stage?.state) {
    case 'passed':
      return 'done';
    case 'now':
      return 'now';
    case 'failed':
      return 'failed';
    case 'unknown':
      return 'unknown';
    default:
      return 'to_come';
  }
}

export interface Headline {
  word: string;
  text: string;
  level: 'critical' | 'unknown' | 'progress' | 'ok';
}

const QUEUED = 'ABORT is queued for the line';

/** Return the text of the strip. It states only what the page knows. */
export function headlineOf(press: Press): Headline {
  const history = press.notInHistory ? " The server's command history has no such ABORT." : '';
  switch (press.fate) {
    case 'sending':
      return {
        word: 'ABORT is being sent',
        text: press.tries > 1 ? `Attempt ${press.tries}: the server does not answer.` : '',
        level: 'progress',
      };
    case 'taken':
      return {
        word: QUEUED,
        text: `The server has queued it for the line (#${press.requestId}) and has not recorded it yet.`,
        level: 'progress',
      };
    case 'not_sent':
      return {
        word: 'ABORT NOT SENT',
        text: `${sentence(press.reason)} The sensor has not received it.${history}`,
        level: 'critical',
      };
    case 'unknown':
      return {
        word: 'ABORT UNKNOWN',
        text: `${sentence(press.reason)} It may or may not have reached the sensor.${history}`,
        level: 'unknown',
      };
    case 'recorded':
      return ofCommand(press.command);
  }
}

function ofCommand(command: Command | null): Headline {
  const detail = command?.detail ? `${sentence(command.detail)}` : '';
  switch (command?.result) {
    case 'completed':
      return { word: 'ABORT completed', text: detail, level: 'ok' };
    case 'rejected':
      return {
        word: 'ABORT REJECTED',
        text: `${detail} The sensor received it and did not run it.`.trim(),
        level: 'critical',
      };
    case 'failed':
      return {
        word: 'ABORT FAILED',
        text: `${detail} The sensor received it and did not complete it.`.trim(),
        level: 'critical',
      };
    case 'withdrawn':
      return {
        word: 'ABORT NOT SENT',
        text: `${detail} It was withdrawn before it was sent.`.trim(),
        level: 'critical',
      };
    case 'unknown':
      return {
        word: 'ABORT UNKNOWN',
        text: `${detail} The sensor sent no report; it may or may not have run.`.trim(),
        level: 'unknown',
      };
    case 'resolved':
      return { word: 'ABORT resolved by an operator', text: detail, level: 'unknown' };
    default:
      return {
        word:
          command?.result === 'queued' || command?.result === 'released' ? QUEUED : `ABORT ${command?.result ?? ''}`,
        text: '',
        level: 'progress',
      };
  }
}

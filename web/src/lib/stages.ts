/** Stage lights: what each of the seven points of a command's life looks like. */
import type { Command, Stage } from '../api/types';
import type { LampState } from './lamp';

export const STAGE_NAMES = ['queued', 'released', 'sent', 'accepted', 'started', 'progress', 'completed'] as const;
export type Point = 'passed' | 'done' | 'now' | 'failed' | 'unknown' | 'to_come' | 'skipped';

/** One point per stage name, in order, whatever order or number of stages the server gave. */
export function points(stages: readonly Stage[]): { name: string; point: Point; at: string | null }[] {
  return STAGE_NAMES.map((name) => {
    const found = stages.find((s) => s.name === name);
    const state = found?.state ?? 'to_come';
    const point: Point = state === 'passed' && name === 'completed' ? 'done' : state;
    return { name, point, at: found?.at ?? null };
  });
}

/** Nothing more comes of it. An unknown fate may still become known: by a late report, a retry, or an operator's word. */
export function hasEnded(command: Pick<Command, 'result'>): boolean {
  return ['completed', 'rejected', 'failed', 'resolved', 'withdrawn'].includes(command.result);
}

export function resultState(command: Pick<Command, 'result'>): LampState {
  switch (command.result) {
    case 'completed':
      return 'ok';
    case 'rejected':
    case 'failed':
      return 'critical';
    case 'unknown':
      return 'unknown';
    case 'resolved':
    case 'withdrawn':
      return 'off';
    default:
      return 'progress';
  }
}

export function resultWords(command: Pick<Command, 'result' | 'detail' | 'late'>): string {
  const late = command.late ? ', report late' : '';
  const bad = command.result === 'rejected' || command.result === 'failed';
  return bad && command.detail ? `${command.result}: ${command.detail}${late}` : `${command.result}${late}`;
}

/** Stage lights: the appearance of each of the seven points of a command's life. */
import type { Command, Stage } from '../api/types';
import type { LampState } from './lamp';

export const STAGE_NAMES = ['queued', 'released', 'sent', 'accepted', 'started', 'progress', 'completed'] as const;
export type Point = 'passed' | 'done' | 'now' | 'failed' | 'unknown' | 'to_come' | 'skipped';

/** One point per stage name, in order, regardless of the order and number of stages that the server sent. */
export function points(stages: readonly Stage[]): { name: string; point: Point; at: string | null }[] {
  return STAGE_NAMES.map((name) => {
    const found = stages.find((s) => s.name === name);
    const state = found?.state ?? 'to_come';
    const point: Point = state === 'passed' && name === 'completed' ? 'done' : state;
    return { name, point, at: found?.at ?? null };
  });
}

/**
 * Nothing more is expected. An unknown result may still become known by a late report, a retry or an operator's entry.
 */
export function hasEnded(command: Pick<Command, 'result'>): boolean {
  return ['completed', 'rejected', 'failed', 'resolved', 'withdrawn'].includes(command.result);
}

/** Its outcome is unknown and no operator has said what was found. */
export function isUnsettled(command: Pick<Command, 'result' | 'resolved_note'>): boolean {
  return command.result === 'unknown' && !command.resolved_note;
}

/** The newest commands, and those of unknown outcome however old they are: they wait for an operator. */
export function kept(commands: readonly Command[], most: number): Command[] {
  return commands.filter((c, i) => i < most || isUnsettled(c));
}

/** Two lists of commands as one, newest first, each command once. */
export function joined(newest: readonly Command[], others: readonly Command[]): Command[] {
  const known = new Set(newest.map((c) => c.id));
  return [...newest, ...others.filter((c) => !known.has(c.id))].sort((a, b) => b.id - a.id);
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

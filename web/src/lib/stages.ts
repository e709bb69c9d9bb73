/** Stages of a command and their indicators. */
import type { Command, Stage } from '../api/types';
import type { LampState } from './lamp';

export const STAGE_NAMES = ['queued', 'released', 'sent', 'accepted', 'started', 'progress', 'completed'] as const;
export type Point = 'passed' | 'done' | 'now' | 'failed' | 'unknown' | 'to_come' | 'skipped';

/** Return one point per stage name, in order, regardless of the order and number of stages that the server sent. */
export function points(stages: readonly Stage[]): { name: string; point: Point; at: string | null }[] {
  return STAGE_NAMES.map((name) => {
    const stage = stages.find((s) => s.name === name);
    const state = stage?.state ?? 'to_come';
    const point: Point = state === 'passed' && name === 'completed' ? 'done' : state;
    return { name, point, at: stage?.at ?? null };
  });
}

/**
 * True if no further report is expected. An unknown result can still change through a late report, a retry or an
 * operator's entry.
 */
export function hasEnded(command: Pick<Command, 'result'>): boolean {
  return ['completed', 'rejected', 'failed', 'resolved', 'withdrawn'].includes(command.result);
}

/**
 * True if the command failed or its result is unknown. A command that the server rejected was not sent; the response to
 * its request states the reason.
 */
export function isFailure(command: Pick<Command, 'result' | 'stages'>): boolean {
  if (command.result === 'rejected') return command.stages.some((s) => s.name === 'sent' && s.at !== null);
  return command.result === 'failed' || command.result === 'unknown';
}

/** True if the result is unknown and no operator has resolved it. */
export function isUnsettled(command: Pick<Command, 'result' | 'resolved_note'>): boolean {
  return command.result === 'unknown' && !command.resolved_note;
}

/** Return the reason why a command of unknown result cannot be sent again; empty if it can. */
export function retryProblem(command: Pick<Command, 'can_retry'>): string {
  if (command.can_retry) return '';
  return 'Its unit is not on the line, or does not store its result. Check telemetry, then mark it resolved.';
}

/** Return the latest commands, and all older commands with an unresolved result, which wait for an operator. */
export function retained(commands: readonly Command[], limit: number): Command[] {
  return commands.filter((c, i) => i < limit || isUnsettled(c));
}

/**
 * Return the commands with an unresolved result that the history omits because of its period. A search, and a filter
 * for another result, omit them also.
 */
export function waitingOutside(
  commands: readonly Command[],
  inPeriod: readonly Command[],
  filter: { text: string; user: string; result: string },
): Command[] {
  if (filter.text.trim() || filter.user || (filter.result && filter.result !== 'unknown')) return [];
  return commands.filter((c) => isUnsettled(c) && !inPeriod.includes(c));
}

/** Merge two lists of commands, newest first, each command once. */
export function mergeCommands(newest: readonly Command[], others: readonly Command[]): Command[] {
  const ids = new Set(newest.map((c) => c.id));
  return [...newest, ...others.filter((c) => !ids.has(c.id))].sort((a, b) => b.id - a.id);
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

export function resultText(command: Pick<Command, 'result' | 'detail' | 'late'>): string {
  const late = command.late ? ', late report' : '';
  const failed = command.result === 'rejected' || command.result === 'failed';
  return failed && command.detail ? `${command.result}: ${command.detail}${late}` : `${command.result}${late}`;
}

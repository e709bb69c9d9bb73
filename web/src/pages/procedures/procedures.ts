/** Requests of the pages that show procedures, loaded only with these pages, and texts and lamps of steps. */
import { body, http } from '../../api/http';
import type { components } from '../../api/generated/schema';
import type { LampState } from '../../lib/lamp';

type S = components['schemas'];
const { GET, POST, PUT, DELETE } = http;
export type Procedures = S['ProceduresOut'];
export type Check = S['ProcedureCheckOut'];
export type Run = S['ProcedureRunOut'];
export type RunDetail = S['ProcedureRunDetailOut'];
export type Step = S['ProcedureStepOut'];
export type Entry = S['ProcedureEntryOut'];

const withRunId = (run_id: number): { params: { path: { run_id: number } } } => ({ params: { path: { run_id } } });
export const requests = {
  list: () => body(GET('/api/procedures')),
  check: (text: string, signal?: AbortSignal) =>
    body(POST('/api/procedures/check', { body: { text }, signal, keepalive: false })),
  /** `sha256`: hash of the stored text that was changed. */
  save: (text: string, procedure_id: number | null, sha256: string) =>
    procedure_id === null
      ? body(POST('/api/procedures', { body: { text } }))
      : body(PUT('/api/procedures/{procedure_id}', { params: { path: { procedure_id } }, body: { text, sha256 } })),
  remove: (procedure_id: number) =>
    body(DELETE('/api/procedures/{procedure_id}', { params: { path: { procedure_id } } })),
  /** Start a procedure with the text that the page has. */
  start: ({ id, sha256 }: { id: number; sha256: string }, automatic = false, confirm: string[] = []) =>
    body(
      POST('/api/procedures/{procedure_id}/start', {
        params: { path: { procedure_id: id } },
        body: { sha256, automatic, confirm },
      }),
    ),
  runs: () => body(GET('/api/procedure-runs', { params: { query: { limit: 50 } } })),
  /** The latest runs of a procedure before the run `before`, newest first. */
  earlierRuns: (procedure_id: number, before: number, limit: number) =>
    body(GET('/api/procedure-runs', { params: { query: { procedure_id, before, limit } } })),
  run: (run_id: number) => body(GET('/api/procedure-runs/{run_id}', withRunId(run_id))),
  step: (run_id: number, step: S['StepRunIn']) =>
    body(POST('/api/procedure-runs/{run_id}/step', { ...withRunId(run_id), body: step })),
  skip: (run_id: number, step: string, reason: string) =>
    body(POST('/api/procedure-runs/{run_id}/skip', { ...withRunId(run_id), body: { step, reason } })),
  automatic: (run_id: number, automatic: boolean) =>
    body(POST('/api/procedure-runs/{run_id}/automatic', { ...withRunId(run_id), body: { automatic } })),
  pause: (run_id: number) => body(POST('/api/procedure-runs/{run_id}/pause', withRunId(run_id))),
  resume: (run_id: number) => body(POST('/api/procedure-runs/{run_id}/resume', withRunId(run_id))),
  stop: (run_id: number, reason: string) =>
    body(POST('/api/procedure-runs/{run_id}/stop', { ...withRunId(run_id), body: { reason } })),
};

/** Label of the button of a step, by the kind of the step. */
export const VERBS: Record<Step['kind'], string> = {
  text: 'Done',
  check: 'Check',
  command: 'Send',
  wait: 'Wait',
  question: 'Answer',
  hold: 'Confirm as second person',
  sign: 'Sign',
  branch: 'Decide',
};

const LAMPS: Record<Entry['state'], LampState> = {
  sending: 'progress',
  running: 'progress',
  done: 'ok',
  failed: 'critical',
  skipped: 'watch',
};
export function lampOfEntry(entry: Entry): LampState {
  return LAMPS[entry.state];
}

export function lampOfRun(run: Run): LampState {
  if (run.intact === false) return 'critical';
  return run.state === 'running' ? 'progress' : run.state === 'completed' ? 'ok' : 'watch';
}

/** Return the last entry of a step. A step can be run repeatedly. */
export function lastOf(entries: readonly Entry[], step: string): Entry | undefined {
  return entries.filter((e) => e.step === step).at(-1);
}

/** Format the telemetry values that a condition used. */
export function valuesText(values: Entry['values']): string {
  return Object.entries(values ?? {})
    .map(([name, value]) => `${name} = ${value === null ? 'unknown' : String(value)}`)
    .join(', ');
}

/** Procedure without runnable steps: the paragraphs before its numbered list, the items of the list, and the rest. */
export interface TextProcedure {
  before: string[];
  steps: string[];
  after: string[];
}
export function readTextProcedure(text: string): TextProcedure {
  const read: TextProcedure = { before: [], steps: [], after: [] };
  const lines = text.split('\n').filter((line) => line.trim() && !line.startsWith('# '));
  for (const line of lines) {
    const step = /^\d+\.\s+(.*)/.exec(line)?.[1];
    if (step !== undefined) read.steps.push(step);
    else if (/^\s/.test(line) && read.steps.length)
      read.steps.push(`${read.steps.pop() ?? ''} ${line.trim()}`); // continued item
    else (read.steps.length ? read.after : read.before).push(line);
  }
  return read;
}

/** Split a line of Markdown into plain text, emphasised text and code. */
export function inlineParts(line: string): { kind: 'text' | 'em' | 'code'; text: string }[] {
  return line
    .split(/(\*[^*]+\*|`[^`]+`)/)
    .filter(Boolean)
    .map((part) =>
      /^\*[^*]+\*$/.test(part)
        ? { kind: 'em', text: part.slice(1, -1) }
        : /^`[^`]+`$/.test(part)
          ? { kind: 'code', text: part.slice(1, -1) }
          : { kind: 'text', text: part },
    );
}

export const EXAMPLE = `# Warm start

Prepare the sensor for measurements.

## ready: Check the temperature
The detector must not be warmer than 40 °C.
\`\`\`check
housekeeping.sensor_temperature_c < 40
within: 60 s
else: warm
\`\`\`

## status: Request the status
\`\`\`command
GET_STATUS
\`\`\`

## dark: Look at the sky
\`\`\`question
Is the sky dark?
yes: confirm
no: end
\`\`\`

## warm: Wait until the detector has cooled
\`\`\`wait
1 min
\`\`\`

## confirm: Second person
\`\`\`hold
The unit may be commanded.
\`\`\`

## signed: Sign off
\`\`\`sign
The warm start is complete.
\`\`\`
`;

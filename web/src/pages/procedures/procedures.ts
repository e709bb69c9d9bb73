/** What the page of procedures asks and changes, fetched with the page only; and the states of steps in words. */
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

const of = (run_id: number): { params: { path: { run_id: number } } } => ({ params: { path: { run_id } } });
export const requests = {
  every: () => body(GET('/api/procedures')),
  check: (text: string, signal?: AbortSignal) =>
    body(POST('/api/procedures/check', { body: { text }, signal, keepalive: false })),
  save: (text: string, procedure_id: number | null) =>
    procedure_id === null
      ? body(POST('/api/procedures', { body: { text } }))
      : body(PUT('/api/procedures/{procedure_id}', { params: { path: { procedure_id } }, body: { text } })),
  remove: (procedure_id: number) =>
    body(DELETE('/api/procedures/{procedure_id}', { params: { path: { procedure_id } } })),
  start: (procedure_id: number) =>
    body(
      POST('/api/procedures/{procedure_id}/start', { params: { path: { procedure_id } }, body: { automatic: false } }),
    ),
  runs: () => body(GET('/api/procedure-runs', { params: { query: { limit: 50 } } })),
  run: (run_id: number) => body(GET('/api/procedure-runs/{run_id}', of(run_id))),
  step: (run_id: number, step: S['StepRunIn']) =>
    body(POST('/api/procedure-runs/{run_id}/step', { ...of(run_id), body: step })),
  skip: (run_id: number, step: string, reason: string) =>
    body(POST('/api/procedure-runs/{run_id}/skip', { ...of(run_id), body: { step, reason } })),
  automatic: (run_id: number, automatic: boolean) =>
    body(POST('/api/procedure-runs/{run_id}/automatic', { ...of(run_id), body: { automatic } })),
  resume: (run_id: number) => body(POST('/api/procedure-runs/{run_id}/resume', of(run_id))),
  stop: (run_id: number, reason: string) =>
    body(POST('/api/procedure-runs/{run_id}/stop', { ...of(run_id), body: { reason } })),
};

/** What the button of a step does. */
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

/** The last entry of a step; a step may be run again. */
export function lastOf(entries: readonly Entry[], step: string): Entry | undefined {
  return entries.filter((e) => e.step === step).at(-1);
}

/** The telemetry that a condition used, in words. */
export function valuesText(values: Entry['values']): string {
  return Object.entries(values ?? {})
    .map(([name, value]) => `${name} = ${value === null ? 'unknown' : String(value)}`)
    .join(', ');
}

export const EXAMPLE = `# Warm start

Bring the sensor to a state in which it can measure.

## ready: Check the temperature
The detector must not be warmer than 40 °C.
\`\`\`check
housekeeping.sensor_temperature_c < 40
within: 60 s
else: warm
\`\`\`

## status: Ask for the status
\`\`\`command
GET_STATUS
\`\`\`

## dark: Look at the sky
\`\`\`question
Is the sky dark?
yes: confirm
no: end
\`\`\`

## warm: Wait until it is cooler
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

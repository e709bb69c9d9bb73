/** What the page of derived parameters asks and changes, fetched with the page only. */
import { body, http } from '../../api/http';
import type { components } from '../../api/generated/schema';

type S = components['schemas'];
const { GET, POST, PUT, DELETE } = http;
export type Derived = S['DerivedOut'];
export type DerivedRequest = S['DerivedRequest'];
export type Trial = S['TrialOut'];
export type Range = [number | null, number | null];
export const LEVELS = ['watch', 'warning', 'critical'] as const;

export const requests = {
  every: () => body(GET('/api/telemetry/derived')),
  trial: (expression: string, signal?: AbortSignal) =>
    body(POST('/api/telemetry/derived/check', { body: { expression }, signal, keepalive: false })),
  add: (request: DerivedRequest) => body(POST('/api/telemetry/derived', { body: request })),
  change: (request: DerivedRequest) =>
    body(PUT('/api/telemetry/derived/{name}', { params: { path: { name: request.name } }, body: request })),
  remove: (name: string) => body(DELETE('/api/telemetry/derived/{name}', { params: { path: { name } } })),
  recompute: (name: string, start: string, end: string) =>
    body(POST('/api/telemetry/derived/{name}/recompute', { params: { path: { name } }, body: { start, end } })),
};

/** A bound as typed: null where the field is empty, undefined where it is not a number. */
export function bound(text: string): number | null | undefined {
  const trimmed = text.trim().replace('−', '-');
  if (!trimmed) return null;
  const value = Number(trimmed);
  return Number.isFinite(value) ? value : undefined;
}

/** Low and high of a level as typed; undefined where one is not a number. */
export function range(low: string, high: string): Range | undefined {
  const [from, to] = [bound(low), bound(high)];
  return from === undefined || to === undefined ? undefined : [from, to];
}

export function rangeText(value: readonly (number | null)[]): string {
  const [low, high] = [value[0] ?? null, value[1] ?? null];
  if (low === null && high === null) return '–';
  return `${low ?? ''} … ${high ?? ''}`.trim();
}

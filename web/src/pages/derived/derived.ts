/** Requests of the derived-parameter page. The browser loads them only with this page. */
import { body, http } from '../../api/http';
import type { FieldDefinition } from '../../api/types';
import type { components } from '../../api/generated/schema';

type S = components['schemas'];
const { GET, POST, PUT, DELETE } = http;
export type Derived = S['DerivedOut'];
export type DerivedRequest = S['DerivedRequest'];
export type Trial = S['TrialOut'];
export type Range = [number | null, number | null];
export const LEVELS = ['watch', 'warning', 'critical'] as const;

export const requests = {
  list: () => body(GET('/api/telemetry/derived')),
  trial: (expression: string, signal?: AbortSignal) =>
    body(POST('/api/telemetry/derived/check', { body: { expression }, signal, keepalive: false })),
  add: (request: DerivedRequest) => body(POST('/api/telemetry/derived', { body: request })),
  change: (request: DerivedRequest) =>
    body(PUT('/api/telemetry/derived/{name}', { params: { path: { name: request.name } }, body: request })),
  remove: (name: string) => body(DELETE('/api/telemetry/derived/{name}', { params: { path: { name } } })),
  recompute: (name: string, start: string, end: string) =>
    body(POST('/api/telemetry/derived/{name}/recompute', { params: { path: { name } }, body: { start, end } })),
};

/** Parse a limit: null if the text is empty, undefined if it is not a number. */
export function bound(text: string): number | null | undefined {
  const trimmed = text.trim().replace('−', '-');
  if (!trimmed) return null;
  const value = Number(trimmed);
  return Number.isFinite(value) ? value : undefined;
}

/** Parse the low and high limit of a level; undefined if a text is not a number. */
export function range(low: string, high: string): Range | undefined {
  const [from, to] = [bound(low), bound(high)];
  return from === undefined || to === undefined ? undefined : [from, to];
}

export function rangeText(value: readonly (number | null)[]): string {
  const [low, high] = [value[0] ?? null, value[1] ?? null];
  if (low === null && high === null) return '–';
  if (low === null) return `≤ ${high}`;
  return high === null ? `≥ ${low}` : `${low} … ${high}`;
}

/**
 * Return examples of derived parameters from the telemetry of the connected sensor: a power from a voltage and a
 * current, and a difference of two temperatures.
 */
export function examples(fields: readonly FieldDefinition[]): Partial<Derived>[] {
  const own = fields.filter((f) => f.page !== 'derived');
  const ofUnit = (unit: string): FieldDefinition[] => own.filter((f) => f.unit === unit);
  const [volt] = ofUnit('V');
  const [milliampere] = ofUnit('mA');
  const [warm, cold] = ofUnit('°C');
  const key = (f: FieldDefinition): string => `${f.packet}.${f.name}`;
  const found: Partial<Derived>[] = [];
  if (volt && milliampere)
    found.push({
      name: 'power',
      title: `Power from ${volt.title} and ${milliampere.title}`,
      expression: `${key(volt)} * ${key(milliampere)}`,
      unit: 'mW',
      decimals: 1,
    });
  if (warm && cold)
    found.push({
      name: 'temperature_difference',
      title: `${warm.title} minus ${cold.title}`,
      expression: `${key(warm)} - ${key(cold)}`,
      unit: 'K',
      decimals: 1,
    });
  return found;
}

/** Lamps of the telemetry pages. */
import type { FieldDefinition, Value } from '../../api/types';
import { lampOf, type LampState } from '../../lib/lamp';
import { zones } from '../../lib/limits';

const ORDER: LampState[] = ['critical', 'warning', 'watch', 'stale', 'unknown', 'ok', 'never'];

/** Return the most severe state of the values; `never` without values. */
export function worstOf(values: readonly Pick<Value, 'state'>[]): LampState {
  return ORDER.find((s) => values.some((v) => lampOf(v.state) === s)) ?? 'never';
}

/**
 * Return the values that the lamps count: those of housekeeping, of derived parameters and of packets with a limit.
 * Other packets are sent on request, so that their age is not a fault.
 */
export function monitored<V extends Pick<Value, 'packet' | 'page'>>(
  values: readonly V[],
  fields: Iterable<Pick<FieldDefinition, 'packet' | 'watch' | 'warning' | 'critical'>>,
): V[] {
  const limited = new Set([...fields].filter((f) => zones(f).length > 0).map((f) => f.packet));
  return values.filter((v) => v.packet === 'housekeeping' || v.page === 'derived' || limited.has(v.packet));
}

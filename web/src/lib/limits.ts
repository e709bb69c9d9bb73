/** Geometry of a limit bar: positions of the zones on a track that extends a little beyond the outermost limit. */
import type { FieldDefinition } from '../api/types';

export interface Zone {
  from: number;
  to: number;
  level: 'watch' | 'warn' | 'crit';
}
type Limits = Pick<FieldDefinition, 'watch' | 'warning' | 'critical'>;

export function domainOf(limits: Limits): [number, number] | null {
  const all = [...limits.watch, ...limits.warning, ...limits.critical].filter(
    (v): v is number => v !== null && v !== undefined,
  );
  if (all.length === 0) return null;
  const low = Math.min(...all);
  const high = Math.max(...all);
  const oneSided = low === high || all.length === 1;
  const span = oneSided ? Math.abs(high) || 1 : high - low;
  const hasLow = [limits.watch[0], limits.warning[0], limits.critical[0]].some((v) => v !== null);
  const hasHigh = [limits.watch[1], limits.warning[1], limits.critical[1]].some((v) => v !== null);
  return [hasLow ? low - span * 0.12 : low - span, hasHigh ? high + span * 0.12 : high + span];
}

/** Return the zones as fractions of the track, mildest first, so that more severe zones are painted on top. */
export function zones(limits: Limits): Zone[] {
  const domain = domainOf(limits);
  if (!domain) return [];
  const at = (v: number): number => Math.min(1, Math.max(0, (v - domain[0]) / (domain[1] - domain[0])));
  const out: Zone[] = [];
  for (const [level, pair] of [
    ['watch', limits.watch],
    ['warn', limits.warning],
    ['crit', limits.critical],
  ] as const) {
    if (pair[0] !== null) out.push({ from: 0, to: at(pair[0]), level });
    if (pair[1] !== null) out.push({ from: at(pair[1]), to: 1, level });
  }
  return out;
}

export function position(value: number, limits: Limits): number | null {
  const domain = domainOf(limits);
  return domain ? Math.min(1, Math.max(0, (value - domain[0]) / (domain[1] - domain[0]))) : null;
}

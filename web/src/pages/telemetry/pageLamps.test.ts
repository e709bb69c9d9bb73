import { expect, test } from 'vitest';
import { monitored, worstOf } from './pageLamps';

const value = (packet: string, page: string, state: 'ok' | 'warning' | 'critical' | 'stale') => ({
  packet,
  page,
  state,
});
const field = (packet: string, high: number | null) => ({
  packet,
  watch: [null, high] as [null, number | null],
  warning: [null, null] as [null, null],
  critical: [null, null] as [null, null],
});
const VALUES = [
  value('housekeeping', 'processor', 'ok'),
  value('derived_power_w', 'derived', 'critical'),
  value('supply', 'power', 'warning'),
  value('memory', 'memory', 'stale'),
];

test('the lamps count housekeeping, derived parameters and packets with limits', () => {
  const counted = monitored(VALUES, [field('supply', 2), field('memory', null)]);
  const lamp = (page: string) => worstOf(counted.filter((v) => v.page === page));
  expect(['processor', 'derived', 'power', 'memory'].map(lamp)).toEqual(['ok', 'critical', 'warning', 'never']);
});

import { describe, expect, it } from 'vitest';
import type { AlarmRow } from '../api/types';
import { byUrgency, headerOrder, lampOfAlarms } from './alarms';

const row = (id: number, state: AlarmRow['state'], level: AlarmRow['level'], worst: AlarmRow['worst'], more: Partial<AlarmRow> = {}) =>
  ({ id, packet: 'housekeeping', state, level, worst, shelved: false, raised: `2026-12-01T18:00:${10 + id}Z`, ...more });

describe('the order of alarms', () => {
  it('puts what is outside its limits now before what is back, however bad it was', () => {
    const rows = [row(1, 'cleared', 'ok', 'critical'), row(2, 'raised', 'watch', 'watch'), row(3, 'raised', 'warning', 'warning')];
    expect(byUrgency(rows).map((a) => a.id)).toEqual([3, 2, 1]);
    expect(lampOfAlarms(rows)).toBe('warning');
  });
  it('counts an event of the device until it is seen, and shows what is back by its worst', () => {
    expect(byUrgency([row(1, 'raised', 'watch', 'watch'), row(2, 'cleared', 'critical', 'critical', { packet: 'event' })]).map((a) => a.id)).toEqual([2, 1]);
    expect(lampOfAlarms([row(1, 'cleared', 'ok', 'warning')])).toBe('warning');
  });
  it('leaves shelved alarms to the end and out of the lamp', () => {
    const shelved = row(1, 'raised', 'critical', 'critical', { shelved: true });
    expect(byUrgency([shelved, row(2, 'cleared', 'ok', 'watch')]).map((a) => a.id)).toEqual([2, 1]);
    expect(lampOfAlarms([shelved])).toBeUndefined();
  });
  it('orders the header by the same rule, with lines that are no stored alarm among those of now', () => {
    const lines = [{ id: 'alarm-1', level: 'critical' }, { id: 'noise', level: 'watch' }, { id: 'alarm-2', level: 'warning' }];
    expect(headerOrder(lines, [row(1, 'cleared', 'ok', 'critical'), row(2, 'raised', 'warning', 'warning')]).map((l) => l.id)).toEqual(['alarm-2', 'noise', 'alarm-1']);
  });
});

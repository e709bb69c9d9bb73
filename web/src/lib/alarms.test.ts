import { describe, expect, it } from 'vitest';
import type { AlarmRow, Link } from '../api/types';
import { byUrgency, conditions, headerAlarms, lampOfAlarms, spanAround, subjectFirst, withoutLevel } from './alarms';

const row = (
  id: number,
  state: AlarmRow['state'],
  level: AlarmRow['level'],
  worst: AlarmRow['worst'],
  more: Partial<AlarmRow> = {},
) => ({
  id,
  packet: 'housekeeping',
  field: `field_${id}`,
  state,
  level,
  worst,
  shelved: false,
  raised: `2026-12-01T18:00:${10 + id}Z`,
  text: `alarm ${id}`,
  ...more,
});
const line = (id: string, level: Link['alarms'][number]['level']): Link['alarms'][number] => ({
  id,
  level,
  text: id,
  since: '2026-12-01T18:00:00Z',
});

describe('the order of alarms', () => {
  it('keeps a latched warning before an active watch until it is acknowledged', () => {
    const latched = row(1, 'cleared', 'ok', 'warning');
    const active = row(2, 'raised', 'watch', 'watch');
    expect(byUrgency([active, latched]).map((a) => a.id)).toEqual([1, 2]);
    expect(lampOfAlarms([active, latched])).toBe('warning');
    expect(headerAlarms([], [active, latched])[0]).toMatchObject({ id: 1, level: 'warning' });
  });
  it('puts the unacknowledged one of two equal alarms first', () => {
    const list = [row(1, 'acked', 'warning', 'warning'), row(2, 'raised', 'warning', 'warning')];
    expect(byUrgency(list).map((a) => a.id)).toEqual([2, 1]);
  });
  it('counts an acknowledged alarm with its current level', () => {
    const list = [row(1, 'acked', 'watch', 'critical'), row(2, 'raised', 'warning', 'warning')];
    expect(byUrgency(list).map((a) => a.id)).toEqual([2, 1]);
  });
  it('puts shelved alarms last and keeps them out of lamp and header', () => {
    const shelved = row(1, 'raised', 'critical', 'critical', { shelved: true });
    expect(byUrgency([shelved, row(2, 'cleared', 'ok', 'watch')]).map((a) => a.id)).toEqual([2, 1]);
    expect(lampOfAlarms([shelved])).toBeUndefined();
    expect(headerAlarms([line('alarm-1', 'critical')], [shelved])).toEqual([]);
  });
});

describe('the header', () => {
  it('counts rows and conditions once each, as the Monitor does', () => {
    const rows = [row(1, 'cleared', 'ok', 'warning'), row(2, 'acked', 'watch', 'watch')];
    const reported = [line('alarm-1', 'warning'), line('alarm-2', 'watch'), line('noise', 'watch')];
    const open = rows.filter((a) => !a.shelved).length + conditions(reported, rows).length;
    expect(headerAlarms(reported, rows)).toHaveLength(open);
    expect(open).toBe(3);
  });
  it('shows an alarm whose row is not loaded', () => {
    const reported = [line('alarm-1', 'critical'), line('alarm-2', 'warning')];
    const alarms = headerAlarms(reported, [row(2, 'raised', 'warning', 'warning')]);
    expect(alarms.map((a) => [a.id, a.level])).toEqual([
      [null, 'critical'],
      [2, 'warning'],
    ]);
  });
  it('shows a link without packets once', () => {
    const loss = row(1, 'raised', 'warning', 'warning', { packet: 'link', field: 'housekeeping' });
    expect(conditions([line('silent', 'warning')], [loss])).toEqual([]);
    expect(conditions([line('silent', 'warning')], [])).toHaveLength(1);
  });
});

describe('the span around an alarm', () => {
  it('is five minutes on each side and ends at the present', () => {
    const at = '2026-12-01T18:00:00.000Z';
    expect(spanAround(at, Date.parse(at) + 60_000)).toEqual({
      from: '2026-12-01T17:55:00.000Z',
      to: '2026-12-01T18:01:00.000Z',
    });
    expect(spanAround(at, Date.parse(at) + 3_600_000).to).toBe('2026-12-01T18:05:00.000Z');
  });
});

it('the header begins with the subject of an alarm', () => {
  expect(subjectFirst('Cleared, not acknowledged: Loss of signal')).toBe('Loss of signal, cleared, not acknowledged');
  expect(subjectFirst('Sensor temperature above 45')).toBe('Sensor temperature above 45');
});

it('removes the level from a text that is shown beside it, and no other level', () => {
  expect(withoutLevel('Sensor temperature above 65 (critical)', 'critical')).toBe('Sensor temperature above 65');
  expect(withoutLevel('Sensor temperature above 65 (critical)', 'warning')).toContain('(critical)');
});

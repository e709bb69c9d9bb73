import { describe, expect, it } from 'vitest';
import { outageText, type Outage } from './outage';

const STARTED = '2026-12-01T10:00:00Z';
const outage = (over: Partial<Outage>): string =>
  outageText({
    lost_ms: 1_000,
    back_ms: 76_000,
    events: { from: '', to: '', count: 0 },
    before: STARTED,
    after: STARTED,
    ...over,
  });

describe('the footer after an outage', () => {
  it('states that the server was not restarted if its start time is the same', () => {
    expect(outage({})).toBe('reconnected after 1 min 15 s, no recorded event missed, the server was not restarted');
  });
  it('states that telemetry was not recorded if the server was restarted', () => {
    expect(outage({ after: '2026-12-01T18:35:20Z' })).toBe(
      'reconnected after 1 min 15 s, no recorded event missed, ' +
        'the server was restarted (18:35:20Z); telemetry was not recorded while it was down',
    );
  });
  it('states the period of the events that were fetched', () => {
    const events = { from: '2026-12-01T18:35:01.5Z', to: '2026-12-01T18:36:02Z', count: 4 };
    expect(outage({ events })).toContain('back-filled 18:35:01Z – 18:36:02Z, the server');
  });
  it('states nothing about the server if a start time is not known', () => {
    for (const unknown of [{ before: null }, { after: null }])
      expect(outage(unknown)).toBe('reconnected after 1 min 15 s, no recorded event missed');
  });
});

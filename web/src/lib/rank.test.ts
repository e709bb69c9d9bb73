import { describe, expect, it } from 'vitest';
import { rank } from './rank';

const place = (kind: string, text: string, note = ''): { kind: string; text: string; note: string } => ({
  kind,
  text,
  note,
});
const PLACES = [
  place('catalogue', 'alarm-night 25', '184 stars, 2026-11-21'),
  place('catalogue', '25', 'all large rings, mean 3, 2026-11-21'),
  place('telemetry', 'Sensor temperature', 'sensor_temperature, housekeeping'),
  place('alarm', 'Sensor temperature', 'above 45'),
  place('command', 'SET_EXPOSURE', 'how long the sensor is exposed'),
  place('command', 'TAKE_IMAGE', 'expose and keep a frame'),
  place('page', 'Alarms', 'Telemetry, Monitor'),
  place('page', 'Telemetry', 'g t'),
];
const found = (query: string): string[] => rank(query, PLACES, 9).map((p) => `${p.kind} ${p.text}`);

describe('the order of search results', () => {
  it('puts pages and commands before catalogues of the same name', () => {
    expect(found('alarm')).toEqual(['page Alarms', 'catalogue alarm-night 25', 'alarm Sensor temperature']);
  });
  it('ranks a name that starts with the query before such a note', () => {
    expect(found('sensor').slice(0, 3)).toEqual([
      'alarm Sensor temperature',
      'telemetry Sensor temperature',
      'command SET_EXPOSURE',
    ]);
  });
  it('counts initials as a full match', () => {
    expect(found('ti')[0]).toBe('command TAKE_IMAGE');
  });
  it('shows scattered matches only if there is no better one', () => {
    expect(found('alarm')).not.toContain('catalogue 25');
    expect(found('sestp').length).toBeGreaterThan(0);
  });
  it('tolerates one typing error in each word of a name', () => {
    for (const query of ['temprature', 'sensor tempereture', 'esnsor temp', 'temperatures'])
      expect(found(query)[0], query).toBe('alarm Sensor temperature');
    expect(found('alamrs')[0]).toBe('page Alarms');
    expect(found('tempratur')).toEqual([]);
  });
  it('finds nothing instead of scattered letters of a long query', () => {
    expect(found('temperate sensors')).toEqual([]);
  });
  it('keeps the given order for an empty query', () => {
    expect(rank('', PLACES, 2)).toEqual(PLACES.slice(0, 2));
  });
});

import { describe, expect, it } from 'vitest';
import { readTle } from './tle';

const ONE = '1 25544U 98067A   26331.50000000  .00001764  00000-0  38792-4 0  9990';
const TWO = '2 25544  97.6439 211.2001 0007417  17.6667  85.6398 15.20103472202485';
const sum = (line: string): string =>
  String([...line.slice(0, 68)].reduce((s, c) => s + (c === '-' ? 1 : Number(c) || 0), 0) % 10);
const right = (line: string): string => line.slice(0, 68) + sum(line);

describe('a pasted TLE', () => {
  it('shows epoch, inclination, node and altitude', () => {
    const facts = readTle(`ZA-1\n${right(ONE)}\n${right(TWO)}\n`);
    expect(facts).toMatchObject({ epoch: '2026-11-27T12:00:00.000Z', inclinationDeg: 97.6439, nodeDeg: 211.2001 });
    expect(typeof facts === 'object' && facts.altitudeKm).toBeCloseTo(505.6, 0);
  });
  it('has its mistake beside the field', () => {
    const wrong = right(TWO).slice(0, 68) + String((Number(sum(TWO)) + 1) % 10);
    expect(readTle(`${right(ONE)}\n${wrong}`)).toContain('Line 2 has the checksum');
    expect(readTle(`${right(ONE).slice(0, 60)}\n${right(TWO)}`)).toBe(
      'Line 1 has 60 characters, expected 69. Check the pasted line.',
    );
    expect(readTle('hello')).toContain('Paste line 1 and line 2');
    const blank = right(`${TWO.slice(0, 52)}           ${TWO.slice(63)}`);
    expect(readTle(`${right(ONE)}\n${blank}`)).toContain('not in its columns');
  });
});

import { describe, expect, it } from 'vitest';
import {
  beside,
  bytes,
  clock,
  counted,
  exposure,
  degrees,
  fixed,
  modeWords,
  pairs,
  paragraphs,
  scientific,
  shortHash,
  sigma,
  span,
  diskSize,
} from './format';

describe('numbers', () => {
  it('have a true minus and a narrow group space', () => {
    expect(fixed(-1204.26, 1)).toBe('\u22121\u202f204.3');
    expect(fixed(117955)).toBe('117\u202f955');
  });
  it('give a computed number one decimal more than the published one', () => {
    expect(beside(-0.0454235, -0.0454)).toBe('\u22120.04542');
    expect(beside(1.06279, 1.063)).toBe('1.0628');
    expect(beside(443.52, 435)).toBe('443.5');
    expect(beside(0.0131, 'about 2.5')).toBe('0.0131');
    expect(fixed(812)).toBe('812');
  });
  it('never writes a negative zero, and a plus only with sign', () => {
    expect(fixed(-0.04, 1)).toBe('0.0');
    expect(fixed(16.24, 1, true)).toBe('+16.2');
    expect(fixed(0, 1, true)).toBe('0.0');
  });
  it('calls a standard deviation of more than half a turn not determined', () => {
    expect([sigma(2.06), sigma(648_001), sigma(null)]).toEqual(['2.1″', 'not determined', '–']);
  });
  it('shows a dash for a missing number', () => {
    expect([fixed(null), fixed(undefined, 2), fixed(NaN), degrees(null), scientific(null), span(null)]).toEqual([
      '–',
      '–',
      '–',
      '–',
      '–',
      '–',
    ]);
  });
  it('writes a short exponent of a probability', () => {
    expect(scientific(2.1e-11)).toBe('2e\u221211');
    expect(degrees(-0.31353, 4)).toBe('\u22120.3135°');
  });
});
describe('times and bytes', () => {
  it('writes ages in the largest suitable unit', () => {
    expect([span(0.42), span(42.4), span(173), span(11160), span(277200)]).toEqual([
      '0.4 s',
      '42 s',
      '2 min 53 s',
      '3 h 6 min',
      '3 d 5 h',
    ]);
  });
  it('writes UTC with Z for a time in any zone', () => {
    expect(clock('2026-12-01T20:42:07.412+02:00', 3)).toBe('18:42:07.412Z');
  });
  it('writes an exposure with at least three significant digits', () => {
    expect([0.000_25, 0.012_345, 0.12, 1.5004].map(exposure)).toEqual([
      '0.25 ms',
      '12.3 ms',
      '120 ms',
      `${fixed(1500)} ms`,
    ]);
  });
  it('groups hex by bytes and shortens hashes', () => {
    expect(pairs('184dc020')).toBe('18 4d c0 20');
    expect(shortHash('7f21aaaaaaaa09c0')).toBe('7f21…09c0');
  });
  it('writes the name of a mode as words', () => {
    expect([modeWords('lost_in_space'), modeWords(null)]).toEqual(['lost in space', '']);
  });
  it('uses the singular for one', () => {
    expect([counted(1, 'frame'), counted(0, 'frame'), counted(1200, 'frame')]).toEqual([
      '1 frame',
      '0 frames',
      '1\u202f200 frames',
    ]);
  });
  it('writes disks in units of 1000, flash in units of 1024', () => {
    expect([diskSize(0), diskSize(999), diskSize(129_400_000), diskSize(58_400_000_000)]).toEqual([
      '0 B',
      '999 B',
      '129.4 MB',
      '58.4 GB',
    ]);
    expect(bytes(524_288)).toBe('512.0 KiB');
  });
});

describe('texts of packages', () => {
  it('joins wrapped lines and keeps a line per sentence', () => {
    expect(paragraphs('Boot first.\nNames of\nvalues: none.\n\nEnd')).toBe(
      'Boot first.\nNames of values: none.\n\nEnd',
    );
  });
});

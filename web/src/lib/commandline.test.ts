import { describe, expect, it } from 'vitest';
import type { Argument, CommandDefinition } from '../api/types';
import { readLine } from './commandline';

const argument = (name: string, more: Partial<Argument> = {}): Argument => ({
  name,
  type: 'u16',
  unit: '',
  purpose: '',
  min: 0,
  max: 100,
  default: null,
  choices: [],
  ...more,
});
const command = (name: string, ...args: Argument[]): CommandDefinition =>
  ({ name, purpose: name, arguments: args }) as unknown as CommandDefinition;
const MODES = ['standby', 'lost_in_space', 'tracking'].map((n) => ({
  name: n,
  value: 0,
  note: '',
})) as unknown as Argument['choices'];
const ALL = [
  command('SET_MODE', argument('mode', { type: 'enum', choices: MODES })),
  command('SET_DETECTION', argument('threshold_dn', { default: 22 }), argument('smallest_px'), argument('largest_px')),
  command('GET_STATUS'),
];
const read = (line: string) => readLine(line, ALL);

describe('a command written as a line', () => {
  it('completes a name from a few of its letters', () => {
    expect(read('se').completions.map((c) => c.text)).toEqual(['SET_MODE', 'SET_DETECTION']);
    expect(read('gst').completions[0]?.replace).toBe('GET_STATUS');
  });
  it('accepts a full name in any case', () => {
    expect(read('get_status').definition?.name).toBe('GET_STATUS');
  });
  it('accepts values in order, by name, or mixed', () => {
    expect(read('set_detection 30 4 60').texts).toEqual({ threshold_dn: '30', smallest_px: '4', largest_px: '60' });
    expect(read('set_detection largest_px=60 30').texts).toEqual({ largest_px: '60', threshold_dn: '30' });
  });
  it('offers the choices of an enumeration and accepts one in any case', () => {
    expect(read('set_mode tr').completions[0]).toMatchObject({ text: 'tracking', replace: 'set_mode tracking ' });
    expect(read('set_mode TRACKING').texts).toEqual({ mode: 'tracking' });
  });
  it('offers the default, then the names of missing arguments', () => {
    expect(read('set_detection ').completions[0]).toMatchObject({ text: '22', note: 'default' });
    expect(read('set_detection 30 l').completions.map((c) => c.text)).toContain('largest_px=');
  });
  it('reports which argument is being entered', () => {
    expect(read('set_detection 30 ').argument?.name).toBe('smallest_px');
    expect(read('set_detection 30 largest_px=6').argument?.name).toBe('largest_px');
  });
  it('reports what is wrong with the line', () => {
    expect(read('fly_home ').problem).toContain('Unknown command FLY_HOME');
    expect(read('get_status 3').problem).toContain('takes no values');
    expect(read('set_mode tracking 2').problem).toContain('remove “2”');
    expect(read('set_mode gain=2').problem).toContain('no argument gain');
  });
});

import { describe, expect, it } from 'vitest';
import type { Argument, CommandDefinition, Stage } from '../api/types';
import { collect, parse, presentText } from './arguments';
import { position, zones } from './limits';
import { countOf, missingBelow, rangesText } from './ranges';
import { hasEnded, points, resultState, resultText } from './stages';

const number = (over: Partial<Argument> = {}): Argument => ({
  name: 'threshold_dn',
  type: 'u8',
  unit: 'DN',
  purpose: '',
  min: 0,
  max: 255,
  default: 22,
  choices: [],
  ...over,
});

describe('arguments', () => {
  it('reports the range and the input of an invalid value', () => {
    expect(parse(number(), '300')).toEqual({ value: null, problem: '0 – 255, got 300' });
    expect(parse(number(), '-1').problem).toBe('0 – 255, got \u22121');
    expect(parse(number(), '12.5').problem).toContain('whole number');
    expect(parse(number(), 'x').problem).toContain('got “x”');
  });
  it('begin with the value on board, if the argument can have it', () => {
    const choices = [{ name: 'tracking', value: 2, hazard: 'none' as const, note: '' }];
    expect(presentText(number({ choices, default: 'standby' }), 'tracking')).toBe('tracking');
    expect(presentText(number({ choices }), 'unknown mode')).toBeNull();
    expect(presentText(number(), 0.12345)).toBe('0.123');
    expect(presentText(number(), undefined)).toBeNull();
  });
  it('accept both limits and the true minus', () => {
    expect([
      parse(number(), '0').value,
      parse(number(), '255').value,
      parse(number({ type: 'f32', min: -9 }), '\u22122.5').value,
    ]).toEqual([0, 255, -2.5]);
  });
  it('accept only true and false for a yes/no value', () => {
    const flag = number({ name: 'filter_enable', type: 'bool', min: null, max: null, default: null });
    expect(['true', 'false'].map((text) => parse(flag, text))).toEqual([
      { value: true, problem: '' },
      { value: false, problem: '' },
    ]);
    expect(parse(flag, 'ture')).toEqual({ value: null, problem: 'true or false is needed, got “ture”' });
    expect(parse(flag, '').problem).toBe('true or false is needed, got nothing');
    const definition = { arguments: [flag] } as unknown as CommandDefinition;
    expect(collect(definition, {})).toEqual({ values: { filter_enable: false }, problems: {} });
  });
  it('fills a form from defaults and reports each wrong argument by name', () => {
    const definition = {
      arguments: [
        number(),
        number({ name: 'bank', choices: [{ name: 'A', value: 0, hazard: 'none', note: '' }], default: null }),
      ],
    } as unknown as CommandDefinition;
    expect(collect(definition, {})).toEqual({ values: { threshold_dn: 22, bank: 'A' }, problems: {} });
    expect(Object.keys(collect(definition, { threshold_dn: '' }).problems)).toEqual(['threshold_dn']);
  });
});
describe('stage lights', () => {
  const stage = (name: Stage['name'], state: Stage['state']): Stage => ({ name, state, at: null });
  it('always have seven points in order, with a separate kind for completed', () => {
    const list = points([stage('completed', 'passed'), stage('queued', 'passed'), stage('progress', 'skipped')]);
    expect(list.map((p) => p.point)).toEqual(['passed', 'to_come', 'to_come', 'to_come', 'to_come', 'skipped', 'done']);
  });
  it('show failed and unknown at their stage', () => {
    expect(points([stage('accepted', 'unknown')])[3]?.point).toBe('unknown');
    expect(points([stage('started', 'failed')])[4]?.point).toBe('failed');
  });
  it('show the reason of a refusal beside the word', () => {
    expect(resultText({ result: 'rejected', detail: 'above 1 000 ms', late: false })).toBe('rejected: above 1 000 ms');
    expect(resultText({ result: 'completed', detail: '', late: true })).toBe('completed, late report');
    expect([resultState({ result: 'unknown' }), resultState({ result: 'sent' })]).toEqual(['unknown', 'progress']);
  });
  it('allow an unknown result to become known, and nothing after an end', () => {
    const ended = (result: string): boolean => hasEnded({ result });
    expect(['unknown', 'queued', 'started'].some(ended)).toBe(false);
    expect(['completed', 'rejected', 'failed', 'resolved', 'withdrawn'].every(ended)).toBe(true);
    expect(['resolved', 'withdrawn'].map((result) => resultState({ result }))).toEqual(['off', 'off']);
  });
});
describe('chunk ranges', () => {
  it('count only the gaps below the highest stored chunk as missing', () => {
    const gaps = missingBelow([
      [122, 145],
      [0, 96],
      [103, 120],
    ]);
    expect(gaps).toEqual([
      [97, 102],
      [121, 121],
    ]);
    expect([countOf(gaps), rangesText(gaps)]).toEqual([7, '97 – 102, 121']);
  });
  it('have no gap in a complete transfer', () => {
    expect(missingBelow([[0, 10]])).toEqual([]);
    expect(missingBelow([])).toEqual([]);
  });
});
describe('limit bars', () => {
  const limits = { watch: [-15, 45], warning: [-20, 55], critical: [-30, 65] } as {
    watch: [number, number];
    warning: [number, number];
    critical: [number, number];
  };
  it('put the more severe zones outside', () => {
    const z = zones(limits);
    expect(z.filter((b) => b.level === 'crit')[1]?.from).toBeGreaterThan(
      z.filter((b) => b.level === 'watch')[1]?.from ?? 1,
    );
    expect(position(15, limits)).toBeGreaterThan(0.4);
    expect(position(1000, limits)).toBe(1);
  });
  it('draw nothing without limits', () => {
    const none = { watch: [null, null], warning: [null, null], critical: [null, null] } as {
      watch: [null, null];
      warning: [null, null];
      critical: [null, null];
    };
    expect([zones(none), position(1, none)]).toEqual([[], null]);
  });
});

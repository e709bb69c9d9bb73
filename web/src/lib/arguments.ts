/**
 * Arguments of a command as text in a form, and back to values, with the range in the message if a value does not fit.
 */
import type { Argument, ArgumentValue, CommandDefinition, Value } from '../api/types';
import { short } from './format';

export function startText(a: Argument): string {
  if (a.default !== null && a.default !== undefined) return String(a.default);
  const first = a.choices[0];
  return first ? first.name : a.min !== null ? String(a.min) : '';
}

export function rangeText(a: Argument, withDefault = true): string {
  const range =
    a.min !== null && a.max !== null
      ? `${short(a.min)} – ${short(a.max)}`
      : a.min !== null
        ? `${short(a.min)} or more`
        : a.max !== null
          ? `up to ${short(a.max)}`
          : '';
  const start =
    withDefault && a.default !== null && a.default !== undefined
      ? `default ${typeof a.default === 'number' ? short(a.default) : String(a.default)}`
      : '';
  return [range, start].filter(Boolean).join(', ');
}

const isText = (a: Argument): boolean => /str|text|hex|bytes|hash/.test(a.type);
const isFlag = (a: Argument): boolean => /^bool/.test(a.type);
const isWhole = (a: Argument): boolean => /^u?int|^[ui]\d/.test(a.type);

export function parse(a: Argument, text: string): { value: ArgumentValue | null; problem: string } {
  if (a.choices.length || isText(a))
    return text === '' ? { value: null, problem: 'a value is needed' } : { value: text, problem: '' };
  if (isFlag(a)) return { value: text === 'true', problem: '' };
  const value = Number(text.replace('\u2212', '-').replace(/[\s\u2009]/g, ''));
  if (text.trim() === '' || !Number.isFinite(value))
    return { value: null, problem: `a number is needed, got ${text === '' ? 'nothing' : `“${text}”`}` };
  const low = a.min !== null && value < a.min;
  const high = a.max !== null && value > a.max;
  if (low || high) return { value: null, problem: `${rangeText(a, false)}, got ${short(value)}` };
  if (isWhole(a) && !Number.isInteger(value))
    return { value: null, problem: `a whole number is needed, got ${short(value)}` };
  return { value, problem: '' };
}

const UNIT_SUFFIX = /_(s|ms|us|dn|px|c|v|ma|hz|deg|mag)$/;

/** An argument's name in words, without the unit shown beside its value: "bit error rate", "duration". */
export function nameInWords(a: Pick<Argument, 'name' | 'unit'>): string {
  return (a.unit ? a.name.replace(UNIT_SUFFIX, '') : a.name).replace(/_/g, ' ').replace(/^./, (c) => c.toUpperCase());
}

/** The telemetry value that shows the device's present value of an argument: same name, with or without its unit. */
export function onBoard(a: Argument, values: ReadonlyMap<string, Value>): Value | null {
  const bare = a.name.replace(UNIT_SUFFIX, '');
  const exact = values.get(a.name);
  if (exact) return exact;
  for (const [name, v] of values) if (name.replace(UNIT_SUFFIX, '') === bare) return v;
  return null;
}

export function flag(a: Argument): boolean {
  return isFlag(a);
}
export function textual(a: Argument): boolean {
  return isText(a);
}

/** The values of a whole form; `problem` of the first invalid argument. */
export function collect(
  definition: CommandDefinition,
  texts: Readonly<Record<string, string>>,
): { values: Record<string, ArgumentValue>; problems: Record<string, string> } {
  const values: Record<string, ArgumentValue> = {};
  const problems: Record<string, string> = {};
  for (const a of definition.arguments) {
    const { value, problem } = parse(a, texts[a.name] ?? startText(a));
    if (problem) problems[a.name] = problem;
    else if (value !== null) values[a.name] = value;
  }
  return { values, problems };
}

/**
 * Convert the arguments of a command to form texts and back to values. The message for an invalid value states the
 * range.
 */
import type { Argument, ArgumentValue, CommandDefinition, Value } from '../api/types';
import { short } from './format';

export function startText(a: Argument): string {
  if (a.default !== null && a.default !== undefined) return String(a.default);
  if (isFlag(a)) return 'false';
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

export const isText = (a: Argument): boolean => /str|text|hex|bytes|hash/.test(a.type);
export const isFlag = (a: Argument): boolean => /^bool/.test(a.type);
const isInteger = (a: Argument): boolean => /^u?int|^[ui]\d/.test(a.type);

export function parse(a: Argument, text: string): { value: ArgumentValue | null; problem: string } {
  if (a.choices.length || isText(a))
    return text === '' ? { value: null, problem: 'a value is needed' } : { value: text, problem: '' };
  if (isFlag(a))
    return text === 'true' || text === 'false'
      ? { value: text === 'true', problem: '' }
      : { value: null, problem: `true or false is needed, got ${text === '' ? 'nothing' : `“${text}”`}` };
  const value = Number(text.replace('\u2212', '-').replace(/\s/g, ''));
  if (text.trim() === '' || !Number.isFinite(value))
    return { value: null, problem: `a number is needed, got ${text === '' ? 'nothing' : `“${text}”`}` };
  const low = a.min !== null && value < a.min;
  const high = a.max !== null && value > a.max;
  if (low || high) return { value: null, problem: `${rangeText(a, false)}, got ${short(value)}` };
  if (isInteger(a) && !Number.isInteger(value))
    return { value: null, problem: `a whole number is needed, got ${short(value)}` };
  return { value, problem: '' };
}

const UNIT_SUFFIX = /_(s|ms|us|dn|px|c|v|ma|hz|deg|mag)$/;

/**
 * Return an argument's name in words, without the unit that is shown beside its value: "Bit error rate", "Duration".
 */
export function nameInWords(a: Pick<Argument, 'name' | 'unit'>): string {
  return (a.unit ? a.name.replace(UNIT_SUFFIX, '') : a.name).replace(/_/g, ' ').replace(/^./, (c) => c.toUpperCase());
}

/** Return the telemetry value with the argument's name, with or without the unit suffix; null if there is none. */
export function onBoard(a: Argument, values: ReadonlyMap<string, Value>): Value | null {
  const nameWithoutUnit = a.name.replace(UNIT_SUFFIX, '');
  const exact = values.get(a.name);
  if (exact) return exact;
  for (const [name, v] of values) if (name.replace(UNIT_SUFFIX, '') === nameWithoutUnit) return v;
  return null;
}

/** Return the form text of an argument whose value on board is known; null if the argument cannot have this value. */
export function presentText(a: Argument, value: Value['value'] | undefined): string | null {
  if (a.choices.length) return a.choices.find((c) => c.name === value)?.name ?? null;
  return typeof value === 'number' ? String(Number(value.toFixed(3))) : null;
}

/** Return the values of a form, and the problem of each invalid argument. */
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

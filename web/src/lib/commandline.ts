/** Parse a line of text as a command: its name, then values in the dictionary's order or as name=value. */
import type { Argument, CommandDefinition } from '../api/types';
import { rangeText } from './arguments';
import { best } from './fuzzy';

export interface Completion {
  text: string;
  note: string;
  replace: string;
}
export interface Line {
  definition: CommandDefinition | null;
  /** The text entered for each argument. */
  texts: Record<string, string>;
  /** What is wrong with the line itself; values are checked by the form's rules. */
  problem: string;
  completions: Completion[];
  /** The argument being entered, to show its range. */
  argument: Argument | null;
}

interface Word {
  text: string;
  from: number;
}

/** Split at spaces; quotes keep a space inside a value. */
export function split(line: string): Word[] {
  const out: Word[] = [];
  for (const m of line.matchAll(/(?:"[^"]*"?|[^\s"])+/g)) out.push({ text: m[0].replace(/"/g, ''), from: m.index });
  return out;
}

export function readLine(line: string, commands: readonly CommandDefinition[]): Line {
  const words = split(line);
  const open = line === '' || /\s$/.test(line);
  const name = words[0]?.text ?? '';
  if (words.length === 0 || (words.length === 1 && !open)) return naming(name, commands);
  const definition = commands.find((c) => c.name === name.toUpperCase()) ?? null;
  if (!definition)
    return {
      definition: null,
      texts: {},
      problem: `Unknown command ${name.toUpperCase()}`,
      completions: [],
      argument: null,
    };
  return arguing(definition, line, words.slice(1), open);
}

function naming(name: string, commands: readonly CommandDefinition[]): Line {
  const definition = commands.find((c) => c.name === name.toUpperCase()) ?? null;
  const hits = definition ? [] : best(name, commands, (c) => c.name, 8);
  const completions = hits.map((c) => ({
    text: c.name,
    note: c.purpose,
    replace: c.arguments.length ? `${c.name} ` : c.name,
  }));
  return {
    definition,
    texts: {},
    problem: definition || hits.length || name === '' ? '' : `No command matches “${name}”`,
    completions,
    argument: null,
  };
}

function arguing(definition: CommandDefinition, line: string, words: readonly Word[], open: boolean): Line {
  const texts: Record<string, string> = {};
  let problem = '';
  let argument: Argument | null = null;
  words.forEach((w, i) => {
    const [a, text, why] = take(definition, texts, w.text, open || i < words.length - 1);
    if (why) problem ||= why;
    if (a && text !== null) texts[a.name] = text;
    argument = a;
  });
  const last = words.at(-1);
  const writing = !open && last ? last : null;
  if (!writing) argument = definition.arguments.find((a) => !(a.name in texts)) ?? null;
  const before = writing ? line.slice(0, writing.from) : line;
  return {
    definition,
    texts,
    problem,
    argument,
    completions: complete(definition, texts, argument, writing?.text ?? '', before),
  };
}

/** The argument that a word belongs to, its text, and what is wrong with the word. */
function take(
  definition: CommandDefinition,
  sofar: Readonly<Record<string, string>>,
  word: string,
  finished: boolean,
): [Argument | null, string | null, string] {
  const at = word.indexOf('=');
  if (at > 0) {
    const named = definition.arguments.find((a) => a.name === word.slice(0, at).toLowerCase());
    return named
      ? [named, word.slice(at + 1), '']
      : [null, null, `${definition.name} has no argument ${word.slice(0, at)}`];
  }
  const free = definition.arguments.find((a) => !(a.name in sofar));
  if (!free)
    return [
      null,
      null,
      definition.arguments.length
        ? `${definition.name} takes ${definition.arguments.length} ` +
          `value${definition.arguments.length === 1 ? '' : 's'}, “${word}” is one too many`
        : `${definition.name} takes no values`,
    ];
  const begun = definition.arguments.find(
    (a) => !(a.name in sofar) && word !== '' && a.name.startsWith(word.toLowerCase()),
  );
  const value = free.choices.length === 0 && /^[a-z_]/i.test(word) && !/bool|str|text|hex|bytes|hash/.test(free.type);
  if (begun && value && !finished) return [begun, null, ''];
  return [free, choice(free, word), ''];
}

/** A choice is accepted in any case; booleans as yes and no. */
function choice(a: Argument, word: string): string {
  const same = a.choices.find((c) => c.name.toLowerCase() === word.toLowerCase());
  if (same) return same.name;
  if (/^bool/.test(a.type))
    return /^(on|yes|true|1)$/i.test(word) ? 'true' : /^(off|no|false|0)$/i.test(word) ? 'false' : word;
  return word;
}

function complete(
  definition: CommandDefinition,
  texts: Readonly<Record<string, string>>,
  argument: Argument | null,
  word: string,
  before: string,
): Completion[] {
  const out: Completion[] = [];
  const eq = word.indexOf('=');
  const typed = eq > 0 ? word.slice(eq + 1) : word;
  const head = before + (eq > 0 ? word.slice(0, eq + 1) : '');
  if (argument) {
    const values = /^bool/.test(argument.type)
      ? [
          { name: 'on', note: '' },
          { name: 'off', note: '' },
        ]
      : argument.choices;
    const whole = values.some((v) => v.name.toLowerCase() === typed.toLowerCase());
    if (!whole)
      for (const v of best(typed, values, (c) => c.name, 8))
        out.push({ text: v.name, note: v.note ?? '', replace: `${head}${v.name} ` });
    const start = argument.default;
    if (typed === '' && values.length === 0 && start !== null && start !== undefined)
      out.push({ text: String(start), note: 'default', replace: `${head}${String(start)} ` });
  }
  if (eq < 0)
    for (const a of definition.arguments.filter((x) => !(x.name in texts) || x === argument)) {
      if (word !== '' && !a.name.startsWith(word.toLowerCase())) continue;
      out.push({
        text: `${a.name}=`,
        note: [a.unit, rangeText(a), a.choices.map((c) => c.name).join(' | ')].filter(Boolean).join(', ') || a.purpose,
        replace: `${before}${a.name}=`,
      });
    }
  return out;
}

/** Parse a line of text as a command: its name, followed by values in the dictionary's order or as name=value. */
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
  /** Text entered for each argument. */
  texts: Record<string, string>;
  /** Problem of the line; the values are checked by the rules of the form. */
  problem: string;
  completions: Completion[];
  /** Argument that is being entered; its range is shown. */
  argument: Argument | null;
}

interface Word {
  text: string;
  from: number;
}

/** Split a line at spaces. Quotation marks keep spaces inside a value. */
export function split(line: string): Word[] {
  const out: Word[] = [];
  for (const m of line.matchAll(/(?:"[^"]*"?|[^\s"])+/g)) out.push({ text: m[0].replace(/"/g, ''), from: m.index });
  return out;
}

export function readLine(line: string, commands: readonly CommandDefinition[]): Line {
  const words = split(line);
  const open = line === '' || /\s$/.test(line);
  const name = words[0]?.text ?? '';
  if (words.length === 0 || (words.length === 1 && !open)) return parseName(name, commands);
  const definition = commands.find((c) => c.name === name.toUpperCase()) ?? null;
  if (!definition)
    return {
      definition: null,
      texts: {},
      problem: `Unknown command ${name.toUpperCase()}`,
      completions: [],
      argument: null,
    };
  return parseArguments(definition, line, words.slice(1), open);
}

function parseName(name: string, commands: readonly CommandDefinition[]): Line {
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

function parseArguments(definition: CommandDefinition, line: string, words: readonly Word[], open: boolean): Line {
  const texts: Record<string, string> = {};
  let problem = '';
  let argument: Argument | null = null;
  words.forEach((w, i) => {
    const [a, text, wordProblem] = parseWord(definition, texts, w.text, open || i < words.length - 1);
    if (wordProblem) problem ||= wordProblem;
    if (a && text !== null) texts[a.name] = text;
    argument = a;
  });
  const last = words.at(-1);
  const unfinished = !open && last ? last : null;
  if (!unfinished) argument = definition.arguments.find((a) => !(a.name in texts)) ?? null;
  const before = unfinished ? line.slice(0, unfinished.from) : line;
  return {
    definition,
    texts,
    problem,
    argument,
    completions: complete(definition, texts, argument, unfinished?.text ?? '', before),
  };
}

/** Return the argument to which a word belongs, the argument's text, and the problem of the word. */
function parseWord(
  definition: CommandDefinition,
  entered: Readonly<Record<string, string>>,
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
  const nextArgument = definition.arguments.find((a) => !(a.name in entered));
  if (!nextArgument)
    return [
      null,
      null,
      definition.arguments.length
        ? `${definition.name} takes ${definition.arguments.length} ` +
          `value${definition.arguments.length === 1 ? '' : 's'}; remove “${word}”`
        : `${definition.name} takes no values`,
    ];
  const startedName = definition.arguments.find(
    (a) => !(a.name in entered) && word !== '' && a.name.startsWith(word.toLowerCase()),
  );
  const mayBeName =
    nextArgument.choices.length === 0 &&
    /^[a-z_]/i.test(word) &&
    !/bool|str|text|hex|bytes|hash/.test(nextArgument.type);
  if (startedName && mayBeName && !finished) return [startedName, null, ''];
  return [nextArgument, choice(nextArgument, word), ''];
}

/** Return the argument's value for a word: a choice in its correct case, or a boolean for on, off, yes, no, 1 or 0. */
function choice(a: Argument, word: string): string {
  const match = a.choices.find((c) => c.name.toLowerCase() === word.toLowerCase());
  if (match) return match.name;
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
    const isComplete = values.some((v) => v.name.toLowerCase() === typed.toLowerCase());
    if (!isComplete)
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

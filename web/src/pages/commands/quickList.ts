/**
 * Quick lists: procedures that only send commands, with an optional wait and check before each command. The editor
 * reads and writes the text of the procedure. A procedure that it would write differently is not a quick list.
 */
import type { Check } from '../procedures/procedures';

/** A command of a quick list. Texts are as in the procedure; `delay` and `within` are in seconds. */
export interface Row {
  command: string;
  texts: Record<string, string>;
  delay: string;
  /** Telemetry field of the check, with its packet; empty for no check. */
  field: string;
  op: string;
  value: string;
  within: string;
  /** Markdown text for the operator above the command. */
  note: string;
}

export const OPERATORS = ['==', '!=', '<', '<=', '>', '>='] as const;
const CONDITION = /^(\w+\.\w+) (==|!=|<=|>=|<|>) (.+)$/;

export const blank = (command: string): Row => ({
  command,
  texts: {},
  delay: '',
  field: '',
  op: '==',
  value: '',
  within: '10',
  note: '',
});

/** Return the commands of a checked procedure, or null if the editor would not write the same text again. */
export function rowsOf(check: Pick<Check, 'title' | 'introduction' | 'steps'>, text: string): Row[] | null {
  const rows: Row[] = [];
  let next = blank('');
  for (const step of check.steps) {
    if (step.kind === 'wait') next.delay = step.words.replace(/ s$/, '');
    else if (step.kind === 'check') {
      const [, field = '', op = '', value = ''] = CONDITION.exec(step.words) ?? [];
      next = { ...next, field, op, value: valueOf(value), within: String(step.seconds) };
    } else if (step.kind === 'command') {
      const [command = '', ...pairs] = wordsOf(step.words);
      const texts = Object.fromEntries(pairs.map((p) => [p.slice(0, p.indexOf('=')), p.slice(p.indexOf('=') + 1)]));
      rows.push({ ...next, command, texts, note: step.text });
      next = blank('');
    } else return null;
  }
  return textOf(check.title, check.introduction, rows).trimEnd() === text.trimEnd() ? rows : null;
}

/** Return the text of the procedure of these commands. */
export function textOf(title: string, introduction: string, rows: readonly Row[]): string {
  const head = [`# ${title}\n`, ...(introduction ? [`${introduction}\n`] : [])];
  return [...head, ...rows.flatMap((row, i) => sectionsOf(row, i + 1))].join('\n');
}

function sectionsOf(row: Row, number: number): string[] {
  const { command, delay, field } = row;
  const sections: string[] = [];
  if (Number(delay) !== 0) sections.push(section(`wait-${number}: Wait before ${command}`, 'wait', [`${delay} s`]));
  if (field) {
    const lines = [`${field} ${row.op} ${valueText(row.value)}`, `within: ${row.within} s`];
    sections.push(section(`check-${number}: Check before ${command}`, 'check', lines));
  }
  const words = [command, ...Object.entries(row.texts).map(([name, text]) => `${name}=${text}`)];
  sections.push(section(`send-${number}: Send ${command}`, 'command', [words.map(quoted).join(' ')], row.note));
  return sections;
}

function section(heading: string, kind: string, lines: readonly string[], note = ''): string {
  const prose = note ? `\n${note}\n` : '';
  return `## ${heading}\n${prose}\n${[`\`\`\`${kind}`, ...lines, '```', ''].join('\n')}`;
}

/** Split a command line into words, as the server does for the lines that `quoted` writes. */
const wordsOf = (line: string): string[] =>
  (line.match(/(?:'[^']*'|"'"|[^\s'"])+/g) ?? []).map((word) => word.replace(/'([^']*)'|"(')"/g, '$1$2'));

const quoted = (word: string): string => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", `'"'"'`)}'`);

function valueOf(text: string): string {
  try {
    return text.startsWith('"') ? String(JSON.parse(text)) : text;
  } catch {
    return text;
  }
}

/** Return a value as it is written in an expression: a number, true, false, or a text in quotes. */
function valueText(value: string): string {
  if (value === 'yes' || value === 'no') return String(value === 'yes');
  const plain = value === 'true' || value === 'false' || (value.trim() !== '' && Number.isFinite(Number(value)));
  return plain ? value : JSON.stringify(value);
}

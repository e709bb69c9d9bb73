/**
 * Return a command as text. A command for the device's schedule is shown by its name, not by its bytes. An argument
 * whose value 0 has a meaning in the dictionary is shown with this meaning.
 */
import type { Command, CommandDefinition } from '../api/types';
import { nameInWords } from './arguments';
import { fixed } from './format';

type Definition = Pick<CommandDefinition, 'name' | 'code'> & Partial<Pick<CommandDefinition, 'arguments'>>;

export function commandText(
  command: Pick<Command, 'name' | 'text' | 'arguments'>,
  commands: readonly Definition[],
): string {
  const { command_code: code, at_s: at } = command.arguments as Record<string, unknown>;
  const inner = typeof code === 'number' ? commands.find((c) => c.code === code) : undefined;
  return inner && typeof at === 'number'
    ? `${inner.name} at device time ${fixed(at, 1)} s`
    : withMeanings(command, commands);
}

function withMeanings(command: Pick<Command, 'name' | 'text' | 'arguments'>, commands: readonly Definition[]): string {
  let text = command.text;
  for (const a of commands.find((c) => c.name === command.name)?.arguments ?? []) {
    const meaning = /\b0 = (.+)$/.exec(a.purpose)?.[1];
    if (!meaning || command.arguments[a.name] !== 0) continue;
    const title = nameInWords(a).toLowerCase();
    text = text.replace(new RegExp(`\\b${title} 0(?=,|$)`), `${title}: ${meaning}`);
  }
  return text;
}

/** Return a command as text. A command for the device's schedule is shown by its name, not by its bytes. */
import type { Command, CommandDefinition } from '../api/types';
import { fixed } from './format';

export function commandText(
  command: Pick<Command, 'name' | 'text' | 'arguments'>,
  commands: readonly Pick<CommandDefinition, 'name' | 'code'>[],
): string {
  const { command_code: code, at_s: at } = command.arguments as Record<string, unknown>;
  const inner = typeof code === 'number' ? commands.find((c) => c.code === code) : undefined;
  return inner && typeof at === 'number' ? `${inner.name} at device time ${fixed(at, 1)} s` : command.text;
}

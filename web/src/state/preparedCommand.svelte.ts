/** A command that the command line, the palette or an alarm passes to the form on Commands. */
import { go } from './router.svelte';

export interface CommandValues {
  name: string;
  args: Record<string, unknown>;
  confirm: boolean;
}
class PreparedCommand {
  waiting = $state.raw<CommandValues | null>(null);
}
export const preparedCommand = new PreparedCommand();

/** Open the form with these values. `confirm` also opens its confirmation. */
export function prepareCommand(values: CommandValues): void {
  preparedCommand.waiting = values;
  go(`/commands?command=${values.name}`);
}

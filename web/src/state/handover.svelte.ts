/** A command that the command line, the palette or an alarm passes to the form on Commands. */
import { go } from './router.svelte';

export interface Handed {
  name: string;
  args: Record<string, unknown>;
  confirm: boolean;
}
class Handover {
  waiting = $state.raw<Handed | null>(null);
}
export const handover = new Handover();

/** Open the form with these values. `confirm` also opens its confirmation. */
export function handOver(handed: Handed): void {
  handover.waiting = handed;
  go(`/commands?command=${handed.name}`);
}

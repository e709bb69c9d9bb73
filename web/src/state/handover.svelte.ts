/** A command handed over from the command line, the palette or an alarm to the form on Commands. */
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

/** Opens the form with these values; `confirm` opens its hazard block too. */
export function handOver(handed: Handed): void {
  handover.waiting = handed;
  go(`/commands?command=${handed.name}`);
}

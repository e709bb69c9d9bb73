/** Why a command cannot be given now; empty when it can. */
import type { CommandDefinition, Link } from '../api/types';

const ALWAYS = ['HELLO', 'ABORT'];

export function blocked(link: Link | null, online: boolean, definition?: CommandDefinition): string {
  if (!online) return 'the console is offline';
  if (!link) return 'the state of the link is not known yet';
  if (!link.connected) return 'the link is closed';
  if (link.authority !== null && link.authority !== link.user) return `commanding needs authority, ${link.authority} holds it`;
  if (link.dictionary_match === false && !link.dictionary_acknowledged && !ALWAYS.includes(definition?.name ?? '')) return "the device has another dictionary: acknowledge it in the header first";
  const unmet = definition?.preconditions.find((p) => p.met === false);
  return unmet ? `needs: ${unmet.text} (now ${unmet.value})` : '';
}

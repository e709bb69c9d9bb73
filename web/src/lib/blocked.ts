/** Why a command cannot be sent now; empty if it can. */
import type { CommandDefinition, Link } from '../api/types';
import { session } from '../state/session.svelte';

const ALWAYS = ['HELLO', 'ABORT'];

export function blocked(link: Link | null, online: boolean, definition?: CommandDefinition): string {
  if (!online) return 'the console is offline';
  if (!link) return 'the state of the link is not known yet';
  const role = definition ? session.lacks(`command.${definition.subsystem}`) : session.lacksCommanding();
  if (role && definition?.name !== 'ABORT') return role;
  if (!link.connected) return 'the link is closed';
  if (link.authority !== null && link.authority !== session.name)
    return `commanding needs authority, ${link.authority} holds it`;
  if (link.dictionary_match === false && !link.dictionary_acknowledged && !ALWAYS.includes(definition?.name ?? ''))
    return 'the device has another dictionary: acknowledge it in the header first';
  const unmet = definition?.preconditions.find((p) => p.met === false);
  return unmet ? `needs: ${unmet.text} (now ${unmet.value})` : '';
}

/** Return the reason why a command cannot be sent now; empty if it can be sent. */
import type { CommandDefinition, Link } from '../api/types';
import { session } from '../state/session.svelte';

const ALWAYS = ['HELLO', 'ABORT'];

export function blocked(link: Link | null, online: boolean, definition?: CommandDefinition): string {
  if (!online) return 'the console is offline';
  if (!link) return 'the state of the link is unknown';
  const missingPermission = definition
    ? session.permissionProblem(`command.${definition.subsystem}`)
    : session.commandingProblem();
  if (missingPermission && definition?.name !== 'ABORT') return missingPermission;
  if (!link.connected) return 'the link is closed';
  if (link.authority !== null && link.authority !== session.name)
    return `commanding needs authority, which ${link.authority} holds`;
  if (link.dictionary_match === false && !link.dictionary_acknowledged && !ALWAYS.includes(definition?.name ?? ''))
    return 'the device has a different dictionary; acknowledge this in the header first';
  const unmet = definition?.preconditions.find((p) => p.met === false);
  return unmet ? `needs: ${unmet.text} (now ${unmet.value})` : '';
}

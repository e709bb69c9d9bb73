/** Why a command cannot be given now; empty when it can. */
import type { CommandDefinition, Link } from '../api/types';

export function blocked(link: Link | null, online: boolean, definition?: CommandDefinition): string {
  if (!online) return 'the console is offline';
  if (!link) return 'the state of the link is not known yet';
  if (!link.connected) return 'the link is closed';
  if (link.authority !== null && link.authority !== link.user) return `commanding needs authority, ${link.authority} holds it`;
  const unmet = definition?.preconditions.find((p) => p.met === false);
  return unmet ? `needs: ${unmet.text} (now ${unmet.value})` : '';
}

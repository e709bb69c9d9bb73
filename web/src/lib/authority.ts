/** Command authority as this user sees it: the open request or offer, and how authority was lost. */
import type { Authority } from '../api/types';
import { clock } from './format';

/** `answer`: this user must answer a request or an offer. `sent`: this user waits for an answer. */
export type Waiting = 'answer' | 'sent' | 'none';

export function waitingOf(authority: Authority | null, me: string): Waiting {
  const transfer = authority?.transfer;
  if (!authority || !transfer) return 'none';
  const [sender, recipient] =
    transfer.kind === 'request' ? [transfer.user, authority.holder] : [authority.holder, transfer.user];
  return me === recipient ? 'answer' : me === sender ? 'sent' : 'none';
}

/** Return the open request or offer as a sentence; empty for users who are not involved. */
export function waitingText(authority: Authority | null, me: string): string {
  const transfer = authority?.transfer;
  if (!authority || !transfer) return '';
  const note = transfer.note ? `: ${transfer.note}` : '.';
  switch (waitingOf(authority, me)) {
    case 'answer':
      return transfer.kind === 'request'
        ? `${transfer.user} requested command authority at ${clock(transfer.at)}${note}`
        : `${authority.holder ?? ''} offered you command authority at ${clock(transfer.at)}${note}`;
    case 'sent':
      return transfer.kind === 'request'
        ? `You requested command authority from ${authority.holder ?? ''} at ${clock(transfer.at)}${note}`
        : `You offered command authority to ${transfer.user} at ${clock(transfer.at)}${note}`;
    case 'none':
      return '';
  }
}

/**
 * Return a sentence that states how another user took authority from this user. Empty if this user did not hold it,
 * still holds it, or released it.
 */
export function lossText(heldBefore: boolean, now: Authority | null, me: string): string {
  if (!heldBefore || !now || now.holder === me) return '';
  const last = now.history.find((tenure) => tenure.holder === me && tenure.ended !== null);
  if (last?.ended_by === me) return '';
  const holds = now.holder === null ? 'No user holds it now.' : `${now.holder} holds it now.`;
  if (!last) return `You lost command authority. ${holds}`;
  return last.reason.startsWith('handed over')
    ? `${last.ended_by} accepted command authority from you at ${clock(last.ended)}. ${holds}`
    : `${last.ended_by} broke your command authority at ${clock(last.ended)}: ${last.reason}. ${holds}`;
}

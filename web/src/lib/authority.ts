/** Command authority from this user's view: what waits for an answer, and how authority was lost. */
import type { Authority } from '../api/types';
import { clock } from './format';

/** ``answer``: this user has to answer a request or offer. ``sent``: this user waits for the answer. */
export type Waiting = 'answer' | 'sent' | 'none';

export function waitingOf(authority: Authority | null, me: string): Waiting {
  const transfer = authority?.transfer;
  if (!authority || !transfer) return 'none';
  const [maker, other] =
    transfer.kind === 'request' ? [transfer.user, authority.holder] : [authority.holder, transfer.user];
  return me === other ? 'answer' : me === maker ? 'sent' : 'none';
}

/** What waits, as a sentence. Empty for users whom it does not concern. */
export function waitingText(authority: Authority | null, me: string): string {
  const transfer = authority?.transfer;
  if (!authority || !transfer) return '';
  const note = transfer.note ? `: ${transfer.note}` : '.';
  switch (waitingOf(authority, me)) {
    case 'answer':
      return transfer.kind === 'request'
        ? `${transfer.user} requests command authority since ${clock(transfer.at)}${note}`
        : `${authority.holder ?? ''} offers you command authority since ${clock(transfer.at)}${note}`;
    case 'sent':
      return transfer.kind === 'request'
        ? `You requested command authority from ${authority.holder ?? ''} at ${clock(transfer.at)}${note}`
        : `You offered command authority to ${transfer.user} at ${clock(transfer.at)}${note}`;
    case 'none':
      return '';
  }
}

/**
 * How this user lost authority by the act of another user; empty if it was not held before, is still held, or was given
 * up by this user.
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

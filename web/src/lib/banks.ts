/** Texts and conditions for uploads, rollbacks and bank commands, derived from the banks that the device reports. */
import type { Bank, Catalogue, CommandDefinition, Timeline, Transfer } from '../api/types';
import { day } from './format';
import type { LampState } from './lamp';

export type Precondition = CommandDefinition['preconditions'][number];
const WRITABLE = /^[A-Z]$/;
/** Time within which the device reports its banks after a commit. */
const SETTLE_MS = 6000;

/** Banks that are offered until the device reports its own. */
const USUAL = ['A', 'B', 'C'];

/** Return the lamp and the text for the time until the catalogue of a bank expires. */
export function expiryOf(bank: Pick<Bank, 'days_left' | 'validity_known'>): { state: LampState; word: string } {
  const days = bank.days_left;
  if (days === null)
    return bank.validity_known ? { state: 'ok', word: 'no expiry' } : { state: 'unknown', word: 'validity unknown' };
  if (days < 0) return { state: 'critical', word: 'expired' };
  if (days < 1) return { state: 'warning', word: `${Math.floor(days * 24)} h left` };
  return { state: days < 4 ? 'watch' : 'ok', word: `${Math.floor(days)} d left` };
}

/** Return the period of validity of a catalogue as text. */
export function validityText(c: Pick<Catalogue, 'valid_from' | 'valid_to' | 'validity_known'>): string {
  if (c.valid_to) return `${day(c.valid_from)} to ${day(c.valid_to)}`;
  return c.validity_known ? 'no expiry' : 'validity unknown';
}

const isEmpty = (bank: Bank): boolean => bank.state === 'empty' || bank.state === 'corrupt';
const expired = (bank: Bank): boolean => bank.days_left !== null && bank.days_left < 0;

/**
 * Return the banks that accept an upload: empty banks first, then expired banks, then the others; never the active
 * bank.
 */
export function uploadTargets(banks: readonly Bank[]): Bank[] {
  const rank = (bank: Bank): number => (isEmpty(bank) ? 0 : expired(bank) ? 1 : 2);
  return banks.filter((b) => !b.active && WRITABLE.test(b.bank)).sort((a, b) => rank(a) - rank(b));
}

/** Return the names of the banks that accept an upload at a later time, when another bank can be active. */
export function uploadBanks(banks: readonly Bank[]): string[] {
  const writable = banks.map((b) => b.bank).filter((name) => WRITABLE.test(name));
  return writable.length ? writable.sort() : USUAL;
}

export function contentName(bank: Bank): string {
  return isEmpty(bank) ? bank.state : (bank.catalogue_name ?? 'a catalogue that is not in this store');
}

/** Return a sentence that states what an upload to this bank overwrites; empty if the bank is empty. */
export function replaces(bank: Bank | undefined): string {
  return !bank || isEmpty(bank) ? '' : `Replaces ${contentName(bank)} in bank ${bank.bank}.`;
}

/**
 * Return a sentence if the bank no longer contains what the transfer stored; empty if it does or if this is unknown.
 */
export function replacedBy(transfer: Transfer, banks: readonly Bank[], nowMs: number): string {
  if (transfer.direction !== 'up' || transfer.kind !== 'catalogue' || transfer.finished === null) return '';
  if (nowMs - Date.parse(transfer.finished) < SETTLE_MS) return '';
  const bank = banks.find((b) => b.bank === transfer.target);
  if (!bank || bank.catalogue_id === transfer.catalogue_id) return '';
  return `Bank ${bank.bank} has changed since: it now contains ${contentName(bank)}.`.replace(
    'now contains empty',
    'is now empty',
  );
}

/** Return the bank that was active before the present one; null if the bank history does not contain it. */
export function previousBank(timeline: Timeline | null, active: string | null): { bank: string; name: string } | null {
  const before = (timeline?.stays ?? [])
    .filter((s) => s.ended !== null && s.bank !== active && (s.state === 'active' || s.state === 'trial'))
    .sort((a, b) => Date.parse(b.ended ?? '') - Date.parse(a.ended ?? ''))[0];
  return before ? { bank: before.bank, name: before.name } : null;
}

/** Return a sentence that names the bank to which ROLLBACK_BANK returns. */
export function rollbackText(previous: { bank: string; name: string } | null): string {
  return previous
    ? `Returns to bank ${previous.bank}${previous.name ? `, ${previous.name}` : ''}.`
    : 'The previously active bank is not recorded. The sensor returns to it, or to the golden bank.';
}

/** Return the conditions on the bank that a command names. The device rejects the command if one is not met. */
export function bankConditions(command: string, bankName: string, banks: readonly Bank[]): Precondition[] {
  if (!['ACTIVATE_BANK', 'ERASE_BANK', 'CONFIRM_BANK'].includes(command) || bankName === '') return [];
  const bank = banks.find((b) => b.bank === bankName);
  const value = bank ? `${contentName(bank)}${bank.active ? ', active' : ''}` : 'not reported';
  const met = (rule: (b: Bank) => boolean): boolean | null => (bank ? rule(bank) : null);
  if (command === 'ACTIVATE_BANK')
    return [
      {
        text: `Bank ${bankName} contains a committed catalogue`,
        met: met((b) => !isEmpty(b) && b.sha256 !== null),
        value,
      },
    ];
  if (command === 'CONFIRM_BANK') return [{ text: `Bank ${bankName} is active`, met: met((b) => b.active), value }];
  return [{ text: `Bank ${bankName} is not active`, met: met((b) => !b.active), value }];
}

/** What the pages derive from the banks that the device reports: where an upload and a rollback lead, conditions. */
import type { Bank, CommandDefinition, Timeline, Transfer } from '../api/types';

export type Precondition = CommandDefinition['preconditions'][number];
const WRITABLE = /^[A-Z]$/;
/** Time after a commit within which the device reports its banks again. */
const SETTLE_MS = 6000;

const isEmpty = (bank: Bank): boolean => bank.state === 'empty' || bank.state === 'corrupt';
const expired = (bank: Bank): boolean => bank.days_left !== null && bank.days_left < 0;

/** Banks that take an upload, the best first: empty, then expired, then the others; never the active one. */
export function uploadTargets(banks: readonly Bank[]): Bank[] {
  const rank = (bank: Bank): number => (isEmpty(bank) ? 0 : expired(bank) ? 1 : 2);
  return banks.filter((b) => !b.active && WRITABLE.test(b.bank)).sort((a, b) => rank(a) - rank(b));
}

export function contentName(bank: Bank): string {
  return isEmpty(bank) ? bank.state : (bank.catalogue_name ?? 'a catalogue that is not in this store');
}

/** What an upload to this bank destroys; empty if nothing. */
export function replaces(bank: Bank | undefined): string {
  return !bank || isEmpty(bank) ? '' : `Replaces ${contentName(bank)} in bank ${bank.bank}.`;
}

/** What is in the transfer's bank now, if it is not what the transfer stored there; empty if unknown or the same. */
export function replacedBy(transfer: Transfer, banks: readonly Bank[], nowMs: number): string {
  if (transfer.direction !== 'up' || transfer.kind !== 'catalogue' || transfer.finished === null) return '';
  if (nowMs - Date.parse(transfer.finished) < SETTLE_MS) return '';
  const bank = banks.find((b) => b.bank === transfer.target);
  if (!bank || bank.catalogue_id === transfer.catalogue_id) return '';
  return `Bank ${bank.bank} was changed since: it holds ${contentName(bank)} now.`.replace('holds empty', 'is empty');
}

/** The bank that was active before the present one, as recorded; null: not in the record. */
export function previousBank(timeline: Timeline | null, active: string | null): { bank: string; name: string } | null {
  const before = (timeline?.stays ?? [])
    .filter((s) => s.ended !== null && s.bank !== active && (s.state === 'active' || s.state === 'trial'))
    .sort((a, b) => Date.parse(b.ended ?? '') - Date.parse(a.ended ?? ''))[0];
  return before ? { bank: before.bank, name: before.name } : null;
}

/** Where ROLLBACK_BANK leads, as a sentence. */
export function rollbackText(previous: { bank: string; name: string } | null): string {
  return previous
    ? `Returns to bank ${previous.bank}${previous.name ? `, ${previous.name}` : ''}.`
    : 'The bank that was active before is not in the record: the sensor chooses it, or the golden bank.';
}

/** Conditions on the bank that a command names, which the device would otherwise reject. */
export function bankConditions(command: string, bankName: string, banks: readonly Bank[]): Precondition[] {
  if (!['ACTIVATE_BANK', 'ERASE_BANK', 'CONFIRM_BANK'].includes(command) || bankName === '') return [];
  const bank = banks.find((b) => b.bank === bankName);
  const value = bank ? `${contentName(bank)}${bank.active ? ', active' : ''}` : 'not reported';
  const met = (rule: (b: Bank) => boolean): boolean | null => (bank ? rule(bank) : null);
  if (command === 'ACTIVATE_BANK')
    return [
      {
        text: `Bank ${bankName} holds a committed catalogue`,
        met: met((b) => !isEmpty(b) && b.sha256 !== null),
        value,
      },
    ];
  if (command === 'CONFIRM_BANK') return [{ text: `Bank ${bankName} is active`, met: met((b) => b.active), value }];
  return [{ text: `Bank ${bankName} is not active`, met: met((b) => !b.active), value }];
}

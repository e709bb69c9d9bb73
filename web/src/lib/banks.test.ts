import { describe, expect, it } from 'vitest';
import type { Bank, Timeline, Transfer } from '../api/types';
import {
  bankConditions,
  expiryOf,
  previousBank,
  replacedBy,
  replaces,
  rollbackText,
  uploadTargets,
  uploadBanks,
  validityText,
} from './banks';

const bank = (name: string, over: Partial<Bank> = {}): Bank => ({
  bank: name,
  state: 'committed',
  active: false,
  catalogue_id: 1,
  catalogue_name: 'orion',
  stars: 100,
  pairs: 900,
  sha256: 'aa',
  valid_to: null,
  days_left: null,
  validity_known: true,
  ...over,
});
const empty = (name: string): Bank =>
  bank(name, { state: 'empty', sha256: null, catalogue_id: null, catalogue_name: null });
const up = (over: Partial<Transfer> = {}): Transfer =>
  ({
    direction: 'up',
    kind: 'catalogue',
    target: 'B',
    catalogue_id: 7,
    finished: '2026-12-01T18:00:00Z',
    ...over,
  }) as Transfer;
const later = Date.parse('2026-12-01T19:00:00Z');

describe('banks', () => {
  it('state how long their catalogue lasts, and that this is unknown', () => {
    const left = [null, 3.9, 0.5, -1].map((days_left) => expiryOf(bank('A', { days_left })));
    expect(left.map((e) => `${e.state}: ${e.word}`)).toEqual([
      'ok: no expiry',
      'watch: 3 d left',
      'warning: 12 h left',
      'critical: expired',
    ]);
    expect(expiryOf(bank('A', { validity_known: false }))).toEqual({ state: 'unknown', word: 'validity unknown' });
    const [valid_from, valid_to] = ['2026-12-01T00:00:00Z', '2026-12-31T00:00:00Z'];
    expect([
      validityText({ valid_from, valid_to, validity_known: true }),
      validityText({ valid_from, valid_to: null, validity_known: true }),
      validityText({ valid_from: null, valid_to: null, validity_known: false }),
    ]).toEqual(['2026-12-01 to 2026-12-31', 'no expiry', 'validity unknown']);
  });
  it('proposes an empty bank, then an expired one, never the active or the golden one', () => {
    const banks = [bank('A', { active: true }), bank('B'), empty('C'), bank('D', { days_left: -2 }), bank('golden')];
    expect(uploadTargets(banks).map((b) => b.bank)).toEqual(['C', 'D', 'B']);
    expect(replaces(banks[2])).toBe('');
    expect(replaces(banks[1])).toBe('Replaces orion in bank B.');
  });
  it('offers the reported banks for a later upload, and the usual ones before the first report', () => {
    expect(uploadBanks([bank('golden'), bank('E', { active: true }), bank('D')])).toEqual(['D', 'E']);
    expect(uploadBanks([])).toEqual(['A', 'B', 'C']);
  });
  it('says when the uploaded content is no longer in its bank', () => {
    expect(replacedBy(up(), [bank('B', { catalogue_id: 7 })], later)).toBe('');
    expect(replacedBy(up(), [bank('B')], later)).toBe('Bank B has changed since: it now contains orion.');
    expect(replacedBy(up(), [empty('B')], later)).toBe('Bank B has changed since: it is now empty.');
    expect(replacedBy(up(), [bank('B')], Date.parse('2026-12-01T18:00:02Z'))).toBe('');
    expect(replacedBy(up(), [], later)).toBe('');
  });
  it('names the target of a rollback from the record', () => {
    const stays = [
      { bank: 'A', state: 'active', ended: '2026-12-01T10:00:00Z', name: 'old' },
      { bank: 'C', state: 'active', ended: '2026-12-01T12:00:00Z', name: 'newer' },
      { bank: 'B', state: 'active', ended: null, name: 'now' },
    ];
    const timeline = { stays } as unknown as Timeline;
    expect(rollbackText(previousBank(timeline, 'B'))).toBe('Returns to bank C, newer.');
    expect(rollbackText(previousBank(null, 'B'))).toContain('is not recorded');
  });
  it('holds the activation of an empty bank', () => {
    expect(bankConditions('ACTIVATE_BANK', 'C', [empty('C')])).toEqual([
      { text: 'Bank C contains a committed catalogue', met: false, value: 'empty' },
    ]);
    expect(bankConditions('ACTIVATE_BANK', 'B', [bank('B')])[0]?.met).toBe(true);
    expect(bankConditions('ACTIVATE_BANK', 'B', [])[0]?.met).toBe(null);
    expect(bankConditions('ERASE_BANK', 'A', [bank('A', { active: true })])[0]?.met).toBe(false);
    expect(bankConditions('GET_STATUS', '', [])).toEqual([]);
  });
});

import { expect, it } from 'vitest';
import type { StarCard } from '../../api/types';
import { catalogueSummary, frameSummary, starFacts } from './star';

const card = (changes: Partial<StarCard>): StarCard =>
  ({
    ...{ hip: 1, name: 'HIP 1', other_names: [], ra_deg: 1, dec_deg: -2, epoch_jyear: 2026.2, v_mag: 9.1, b_v: null },
    ...{ proper_motion_mas_yr: 5.42, parallax_mas: 3.5, flags: [], catalogues: [], checked_catalogues: 0 },
    ...{ unnumbered: 0, unknown_banks: [], frames: [], checked_frames: 0 },
    ...changes,
  }) as StarCard;

it('names a value that the star table does not contain unknown', () => {
  expect(Object.fromEntries(starFacts(card({})))['B−V']).toBe('unknown');
  expect(Object.fromEntries(starFacts(card({ proper_motion_mas_yr: null })))['Proper motion']).toBe('unknown');
  expect(Object.fromEntries(starFacts(card({ other_names: ['α Ori', '58 Ori'] })))['Other names']).toBe(
    'α Ori, 58 Ori',
  );
  expect(Object.fromEntries(starFacts(card({ flags: ['variable'] })))['Flags of the star table']).toBe('variable');
});
it('states what was searched and what could not be searched', () => {
  expect(catalogueSummary(card({}))).toBe('No catalogue is stored.');
  const words = catalogueSummary(card({ checked_catalogues: 3, unnumbered: 1, unknown_banks: ['B'] }));
  expect(words).toContain('In 0 of 2 searched catalogues, newest first.');
  expect(words).toContain('1 more catalogue has no star numbers.');
  expect(words).toContain('bank B is not stored');
  expect(frameSummary(card({}))).toBe('No frame is solved.');
  expect(frameSummary(card({ checked_frames: 7 }))).toBe('Matched on the ground in 0 of the newest 7 solved frames.');
});

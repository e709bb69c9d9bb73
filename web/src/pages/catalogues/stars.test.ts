import { expect, it } from 'vitest';
import { noStarsText, starsText } from './stars';

const star = (state: 'kept' | 'rejected') => ({ hip: 1, ra_deg: 0, dec_deg: 0, v_mag: 3, state });

it('states how many stars of a catalogue are not drawn', () => {
  expect(starsText({ stars: 2, sky: [star('kept'), star('kept'), star('rejected')] })).toBe('2 stars');
  expect(starsText({ stars: 3, sky: [star('kept'), star('rejected')] })).toBe('3 stars, 2 not drawn');
  expect(starsText({ stars: 1, sky: [] })).toBe('1 star');
});

it('states why the map of a catalogue has no stars', () => {
  expect(noStarsText({ stars: 2, no_magnitude: 2 })).toContain('No star of this catalogue has a magnitude');
  expect(noStarsText({ stars: 2, no_magnitude: 0 })).toContain('positions are not stored');
  expect(noStarsText({ stars: 0, no_magnitude: 0 })).toContain('has no stars');
});

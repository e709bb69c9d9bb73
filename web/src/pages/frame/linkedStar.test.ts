import { expect, it } from 'vitest';
import { LinkedStar } from './linkedStar';

const stars = [
  { hip: 7, index: 3 },
  { hip: null, index: 4 },
];

it('selects the star of a link once, in the first solution that contains it', () => {
  const link = new LinkedStar();
  expect(link.select(1, 7, [])).toBeNull();
  expect(link.select(1, 7, stars)).toBe(3);
  expect(link.select(1, 7, [{ hip: 7, index: 9 }])).toBeNull();
  expect(link.select(2, 7, stars)).toBe(3);
  expect(link.select(3, null, stars)).toBeNull();
});

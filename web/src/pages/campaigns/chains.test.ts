import { describe, expect, it } from 'vitest';
import { keyFrom, keyOf, optionsFrom, pairOf } from './chains';

describe('chains of the comparison', () => {
  const mine = { chain: 'cubestar', version: '0.5.0', options: 'min_area_px=3, min_votes=4~5' };

  it('are found again from the URL', () => {
    expect(keyFrom(keyOf(mine))).toEqual(mine);
    expect(keyFrom('')).toBeNull();
  });

  it('are compared in one request', () => {
    expect(pairOf(mine, null)).toEqual(mine);
    expect(pairOf(mine, { ...mine, chain: 'aim' }).against_chain).toBe('aim');
  });

  it('take changed constants as text', () => {
    expect(optionsFrom('min_area_px=3, threshold_dn=12.5')).toEqual({ min_area_px: '3', threshold_dn: '12.5' });
    expect(optionsFrom('limits=1,2,3')).toEqual({ limits: '1,2,3' });
    expect(optionsFrom('')).toEqual({});
    expect(optionsFrom('threshold')).toBeNull();
    expect(optionsFrom('=3')).toBeNull();
  });
});

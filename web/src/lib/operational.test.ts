import { describe, expect, it } from 'vitest';
import { canPin, madeWith } from './operational';

describe('the operational ground result', () => {
  it('names chain and camera', () => {
    expect(madeWith({ chain: 'reference', camera_name: 'cubestar' })).toBe('reference chain, camera cubestar');
    expect(madeWith({ chain: 'reference', camera_name: 'blind' })).toBe('reference chain, solved blind');
    expect(madeWith({ chain: 'reference', camera_name: 'field of view' })).toBe(
      'reference chain, field of view entered',
    );
    expect(madeWith({ chain: 'reference', camera_name: '' })).toBe('reference chain, camera not recorded');
    expect(madeWith({ chain: null, camera_name: null })).toBe('');
    expect(madeWith(null)).toBe('');
  });
  it("may be another result of the ground, not the sensor's and not a rerun", () => {
    expect(canPin({ origin: 'ground', replay: null, operational: false })).toBe(true);
    expect(canPin({ origin: 'ground', replay: null, operational: true })).toBe(false);
    expect(canPin({ origin: 'ground', replay: 'equal', operational: false })).toBe(false);
    expect(canPin({ origin: 'on board', replay: null, operational: false })).toBe(false);
  });
});

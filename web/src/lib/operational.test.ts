import { describe, expect, it } from 'vitest';
import { canPin, chainAndCamera } from './operational';

describe('the operational ground result', () => {
  it('names chain and camera', () => {
    expect(chainAndCamera({ chain: 'reference', camera_name: 'cubestar' })).toBe('reference chain, camera cubestar');
    expect(chainAndCamera({ chain: 'reference', camera_name: 'blind' })).toBe('reference chain, solved blind');
    expect(chainAndCamera({ chain: 'reference', camera_name: 'field of view' })).toBe(
      'reference chain, field of view entered',
    );
    expect(chainAndCamera({ chain: 'reference', camera_name: '' })).toBe('reference chain, camera not recorded');
    expect(chainAndCamera({ chain: null, camera_name: null })).toBe('');
    expect(chainAndCamera(null)).toBe('');
  });
  it("may be another result of the ground, not the sensor's and not a rerun", () => {
    expect(canPin({ origin: 'ground', replay: null, operational: false })).toBe(true);
    expect(canPin({ origin: 'ground', replay: null, operational: true })).toBe(false);
    expect(canPin({ origin: 'ground', replay: 'equal', operational: false })).toBe(false);
    expect(canPin({ origin: 'on board', replay: null, operational: false })).toBe(false);
  });
});

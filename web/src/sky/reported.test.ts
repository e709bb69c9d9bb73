import { describe, expect, it } from 'vitest';
import { boresight, camFromIcrs } from './reported';

describe('the attitude in telemetry', () => {
  const q = [0.1, -0.2, 0.3, 0.9];
  it('uses the declared order and direction of the quaternion', () => {
    expect(camFromIcrs(q, 'scalar_last', 'cam_from_icrs')).toEqual(q);
    expect(camFromIcrs([0.9, 0.1, -0.2, 0.3], 'scalar_first', 'cam_from_icrs')).toEqual(q);
    expect(camFromIcrs([-0.1, 0.2, -0.3, 0.9], 'scalar_last', 'icrs_from_cam')).toEqual(q);
  });
  it('points to the pole without rotation for a quaternion of any length', () => {
    expect(boresight([0, 0, 0, 1])?.dec).toBeCloseTo(90);
    expect(boresight([0, 0, 0, 0.01])?.dec).toBeCloseTo(90);
    expect(boresight([0, 0, 0, 0])).toBeNull();
  });
  it('turns about x by 90 degrees to the equator', () => {
    const half = Math.SQRT1_2;
    expect(boresight([half, 0, 0, half])?.dec).toBeCloseTo(0);
    expect(boresight([half, 0, 0, half])?.ra).toBeCloseTo(90);
  });
});

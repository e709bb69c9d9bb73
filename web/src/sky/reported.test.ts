import { describe, expect, it } from 'vitest';
import { boresight, camFromIcrs, rotationBetween } from './reported';

describe('the attitude in telemetry', () => {
  const q = [0.1, -0.2, 0.3, 0.9];
  it('uses the declared order and direction of the quaternion', () => {
    const same = [0, 0, 0, 1];
    expect(camFromIcrs(q, 'scalar_last', 'cam_from_icrs', same)).toEqual(q);
    expect(camFromIcrs([0.9, 0.1, -0.2, 0.3], 'scalar_first', 'cam_from_icrs', same)).toEqual(q);
    expect(camFromIcrs([-0.1, 0.2, -0.3, 0.9], 'scalar_last', 'icrs_from_cam', same)).toEqual(q);
  });
  it('turns from the axes of the sensor to those of the camera', () => {
    // The published example of OreSat: boresight along x, y to the left, z up in the image.
    const published = [0.844218, 0.00786371, 0.5304, -0.0768838];
    const pointing = boresight(camFromIcrs(published, 'scalar_first', 'cam_from_icrs', [0.5, -0.5, 0.5, 0.5]));
    expect(pointing?.ra).toBeCloseTo(17.9868, 3);
    expect(pointing?.dec).toBeCloseTo(63.4233, 3);
    expect(pointing?.roll).toBeCloseTo(360 - 12.238, 3);
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
  it('rolls by the angle of a rotation about the boresight', () => {
    const half = Math.SQRT1_2;
    const about = (deg: number): number[] => {
      const [s, c] = [Math.sin((deg * Math.PI) / 360), Math.cos((deg * Math.PI) / 360)];
      return [half * c, half * s, half * s, half * c];
    };
    const turned = ((boresight(about(30))?.roll ?? NaN) - (boresight(about(0))?.roll ?? NaN) + 360) % 360;
    expect(Math.min(turned, 360 - turned)).toBeCloseTo(30);
    expect(boresight(about(30))?.ra).toBeCloseTo(90);
  });
  it('measures the rotation between two attitudes, whatever their signs', () => {
    const half = Math.SQRT1_2;
    expect(rotationBetween([0, 0, 0, 1], [0, 0, half, half])).toBeCloseTo(90);
    expect(
      rotationBetween(
        q,
        q.map((v) => -v),
      ),
    ).toBeCloseTo(0);
    expect(rotationBetween([0, 0, 0, 0], q)).toBeNaN();
  });
});

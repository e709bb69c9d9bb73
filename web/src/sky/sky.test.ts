import { describe, expect, it } from 'vitest';
import { matrixOf, pixelToSky, raDec, separationDeg, undistort, unit, type Camera } from './camera';
import { pixelAt, pixelCentre } from '../pages/builder/healpix';
import { overlaps, placeLabels, type Want } from './labels';
import { mollweideRaw, skyProjection } from './mollweide';
import { pixelValue } from './pixelValue';
import { grey, paint, table } from './stretch';

const camera: Camera = {
  columns: 1024,
  rows: 512,
  focal_col_px: 1121,
  focal_row_px: 1121,
  centre_col_px: 511.5,
  centre_row_px: 255.5,
  distortion: { model: 'Pinhole' },
};

describe('direction of a pixel', () => {
  // cam_from_icrs of RA 0, Dec 0, roll 0: x to the west, y to the south, z along the boresight.
  const q = [0.5, 0.5, -0.5, 0.5].map((v) => v);
  it('converts the scalar-last quaternion to a rotation matrix', () => {
    const m = matrixOf([0, 0, Math.SQRT1_2, Math.SQRT1_2]);
    expect(m[0][1]).toBeCloseTo(-1, 12);
    expect(m[1][0]).toBeCloseTo(1, 12);
  });
  it('maps the optical centre to the boresight for any roll', () => {
    const boresight = raDec([matrixOf(q)[2][0], matrixOf(q)[2][1], matrixOf(q)[2][2]]);
    const at = pixelToSky(camera, q, 511.5, 255.5);
    expect(separationDeg(unit(at.ra, at.dec), unit(boresight.ra, boresight.dec))).toBeLessThan(1e-9);
    expect(at.exact).toBe(true);
  });
  it('maps one focal length from the centre to 45 degrees', () => {
    const a = pixelToSky(camera, q, 511.5, 255.5);
    const b = pixelToSky(camera, q, 511.5 + 1121, 255.5);
    expect(separationDeg(unit(a.ra, a.dec), unit(b.ra, b.dec))).toBeCloseTo(45, 9);
  });
  it("removes the Brown distortion of the device's measurements", () => {
    const d = { model: 'Brown', k1: -0.32358, k2: 0.12456, p1: 0.00414, p2: -0.00624 };
    const [x, y] = [0.3, -0.15];
    const r2 = x * x + y * y;
    const radial = 1 + r2 * (d.k1 + r2 * d.k2);
    const measured = [
      x * radial + 2 * d.p1 * x * y + d.p2 * (r2 + 2 * x * x),
      y * radial + d.p1 * (r2 + 2 * y * y) + 2 * d.p2 * x * y,
    ] as const;
    const ideal = undistort(d, measured);
    expect(ideal?.[0]).toBeCloseTo(x, 10);
    expect(ideal?.[1]).toBeCloseTo(y, 10);
  });
  it('reports a distortion model that it does not support', () => {
    expect(pixelToSky({ ...camera, distortion: { model: 'Fisheye' } }, q, 0, 0).exact).toBe(false);
  });
  it('is approximate if the attitude is corrected for aberration', () => {
    expect(pixelToSky(camera, q, 0, 0, 20.5).exact).toBe(false);
  });
});

describe('value of a pixel', () => {
  const image = {
    columns: 4,
    rows: 2,
    bits: 8,
    pixels: new Uint8Array([0, 1, 2, 3, 4, 5, 6, 7]),
    offset: 10,
    scale: 2,
  };
  it('is null outside the image', () => {
    expect(pixelValue(image, null, 1, 1)).toBe(20);
    expect(pixelValue(image, null, 4, 1)).toBeNull();
  });
  it('is null if the pixel was not received', () => {
    const rows = { complete: false, held: [], rows_held: [[1, 1]] as [number, number][] };
    expect([pixelValue(image, rows, 1, 0), pixelValue(image, rows, 1, 1)]).toEqual([null, 20]);
    const part = { ...rows, rows_held: [], held: [[2, 0, 1, 2]] as [number, number, number, number][] };
    expect([1, 2, 3].map((col) => pixelValue(image, part, col, 0))).toEqual([null, 14, null]);
    expect(pixelValue(image, { ...rows, complete: true }, 0, 0)).toBe(10);
  });
});

describe('Mollweide', () => {
  it('preserves areas', () => {
    expect(mollweideRaw(0, Math.PI / 2)[1]).toBeCloseTo(Math.SQRT2, 6);
    expect(mollweideRaw(Math.PI, 0)[0]).toBeCloseTo(2 * Math.SQRT2, 12);
    // The ellipse below the parallel has the same share of the map as the zone has of the hemisphere: sin φ
    // (Archimedes).
    for (const deg of [5, 30, 45, 60, 85]) {
      const phi = (deg * Math.PI) / 180;
      const top = mollweideRaw(0, phi)[1];
      const steps = 20000;
      let area = 0;
      for (let i = 0; i < steps; i++) area += 2 * 2 * Math.sqrt(2 - (((i + 0.5) * top) / steps) ** 2) * (top / steps);
      expect(area / (2 * Math.PI)).toBeCloseTo(Math.sin(phi), 6);
    }
  });
  it('has right ascension to the left and declination up, and can be inverted', () => {
    const p = skyProjection(400, 200);
    const [west, east, north] = [p([170, 0]), p([190, 0]), p([180, 40])] as [
      [number, number],
      [number, number],
      [number, number],
    ];
    expect(east[0]).toBeLessThan(west[0]);
    expect(north[1]).toBeLessThan(100);
    const back = p.invert?.(p([85.04, -30.3]) as [number, number]) as [number, number];
    expect(back[0]).toBeCloseTo(85.04, 5);
    expect(back[1]).toBeCloseTo(-30.3, 5);
  });
});

describe('HEALPix rings', () => {
  it('returns each pixel for its centre', () => {
    for (const nside of [1, 2, 4, 16]) {
      const wrong = Array.from({ length: 12 * nside * nside }, (_, i) => i).filter((i) => {
        const c = pixelCentre(nside, i);
        return pixelAt(nside, c.ra, c.dec) !== i;
      });
      expect(wrong).toEqual([]);
    }
  });
  it('agrees with published centres of nside 1', () => {
    expect(pixelCentre(1, 0)).toEqual({ ra: 45, dec: expect.closeTo(41.8103, 4) as number });
    expect(pixelCentre(1, 4)).toEqual({ ra: 0, dec: 0 });
  });
});

describe('labels', () => {
  const want = (key: string, x: number, y: number, rank: number): Want => ({ key, x, y, gap: 14, w: 60, h: 14, rank });
  const area = { x: 0, y: 0, w: 400, h: 200 };
  it('are placed to the right first and never overlap another label or mark', () => {
    const wants = [want('a', 100, 100, 1), want('b', 110, 104, 2), want('c', 104, 96, 3)];
    const placed = placeLabels(
      wants,
      wants.map((w) => ({ x: w.x - 10, y: w.y - 10, w: 20, h: 20 })),
      area,
    );
    expect(placed[0]).toMatchObject({ key: 'a', x: 114 });
    const boxes = placed.map((p) => ({ ...p, w: 60, h: 14 }));
    for (const [i, a] of boxes.entries()) for (const b of boxes.slice(i + 1)) expect(overlaps(a, b)).toBe(false);
  });
  it('omit the least important one when all eight sides are occupied', () => {
    const crowd = Array.from({ length: 40 }, (_, i) => want(`s${i}`, 200 + (i % 3), 100 + (i % 4), i));
    const placed = placeLabels(crowd, [], area);
    expect(placed.length).toBeLessThan(12);
    expect(placed.some((p) => p.key === 's0')).toBe(true);
  });
  it('stay inside the image and outside reserved areas', () => {
    const placed = placeLabels([want('edge', 395, 100, 0)], [], area);
    expect((placed[0]?.x ?? 999) + 60).toBeLessThanOrEqual(400);
    expect(placeLabels([want('in', 50, 50, 0)], [{ x: 0, y: 0, w: 300, h: 200, strict: true }], area)).toEqual([]);
  });
});

describe('stretch', () => {
  it('maps black to 0 and white to 255, reversed when inverted', () => {
    const s = { low: 10, high: 110, kind: 'linear' as const, invert: false };
    expect([grey(5, s), grey(60, s), grey(500, s)]).toEqual([0, 128, 255]);
    expect(grey(5, { ...s, invert: true })).toBe(255);
  });
  it('brightens faint stars with asinh and is monotonic', () => {
    const look = table(255, { low: 0, high: 255, kind: 'asinh', invert: false });
    expect(look[30]).toBeGreaterThan(30);
    expect([...look].every((v, i) => i === 0 || v >= (look[i - 1] ?? 0))).toBe(true);
  });
  it('paints each pixel with its table colour, opaque', () => {
    const out = new Uint8ClampedArray(8);
    paint(Uint8Array.from([0, 255]), table(255, { low: 0, high: 255, kind: 'linear', invert: false }), false, out);
    expect([out[3], out[7]]).toEqual([255, 255]);
    expect(out[4]).toBeGreaterThan(240);
  });
});

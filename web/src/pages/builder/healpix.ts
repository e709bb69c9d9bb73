/** Return the centre of a HEALPix pixel in ring order, in degrees (Górski et al. 2005 §5.1). */
export function pixelCentre(nside: number, pixel: number): { ra: number; dec: number } {
  const count = 12 * nside * nside;
  const cap = 2 * nside * (nside - 1);
  let z: number;
  let phi: number;
  if (pixel < cap) {
    const ring = Math.floor((1 + Math.sqrt(1 + 2 * pixel)) / 2);
    const inRing = pixel - 2 * ring * (ring - 1);
    z = 1 - (ring * ring) / (3 * nside * nside);
    phi = ((inRing + 0.5) * Math.PI) / (2 * ring);
  } else if (pixel < count - cap) {
    const beltIndex = pixel - cap;
    const ring = Math.floor(beltIndex / (4 * nside)) + nside;
    const inRing = beltIndex % (4 * nside);
    const shift = (ring + nside) % 2 === 0 ? 0.5 : 0;
    z = (2 * nside - ring) * (2 / (3 * nside));
    phi = ((inRing + shift) * Math.PI) / (2 * nside);
  } else {
    const back = count - pixel;
    const ring = Math.floor((1 + Math.sqrt(2 * back - 1)) / 2);
    const inRing = 4 * ring + 1 - (back - 2 * ring * (ring - 1));
    z = -1 + (ring * ring) / (3 * nside * nside);
    phi = ((inRing - 0.5) * Math.PI) / (2 * ring);
  }
  return { ra: (phi * 180) / Math.PI, dec: (Math.asin(z) * 180) / Math.PI };
}

/** Return the HEALPix pixel in ring order that contains a direction (Górski et al. 2005; inverse of `pixelCentre`). */
export function pixelAt(nside: number, raDeg: number, decDeg: number): number {
  const z = Math.sin((decDeg * Math.PI) / 180);
  const quadrants = (((raDeg / 90) % 4) + 4) % 4;
  const absZ = Math.abs(z);
  if (absZ <= 2 / 3) {
    const a = nside * (0.5 + quadrants);
    const b = nside * z * 0.75;
    const rising = Math.floor(a - b);
    const falling = Math.floor(a + b);
    const ring = nside + 1 + rising - falling;
    const shift = ring % 2 === 0 ? 1 : 0;
    const inRing = Math.floor((rising + falling - nside + shift + 1) / 2);
    const wrapped = ((inRing % (4 * nside)) + 4 * nside) % (4 * nside);
    return 2 * nside * (nside - 1) + (ring - 1) * 4 * nside + wrapped;
  }
  const within = quadrants - Math.floor(quadrants);
  const span = nside * Math.sqrt(3 * (1 - absZ));
  const ring = Math.floor(within * span) + Math.floor((1 - within) * span) + 1;
  const inRing = Math.min(4 * ring - 1, Math.floor(quadrants * ring));
  return z > 0 ? 2 * ring * (ring - 1) + inRing : 12 * nside * nside - 2 * ring * (ring + 1) + inRing;
}

/** Where a HEALPix ring-ordered pixel is (Górski et al. 2005 §5.1). */
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
    const rest = pixel - cap;
    const ring = Math.floor(rest / (4 * nside)) + nside;
    const inRing = rest % (4 * nside);
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

/** Facts of a pasted two-line element set, shown beside its field before the server checks it. */
const MU_KM3_S2 = 398_600.8; // WGS 72, as in SGP4
const EARTH_RADIUS_KM = 6378.135;

/** Elements of a TLE. Angles in degrees; `altitudeKm`: semi-major axis minus the Earth's equatorial radius. */
export interface TleFacts {
  epoch: string;
  inclinationDeg: number;
  nodeDeg: number;
  altitudeKm: number;
}

/** Sum of the digits of columns 1 to 68, a minus sign counts as 1, modulo 10. */
function checksum(line: string): number {
  return [...line.slice(0, 68)].reduce((sum, c) => sum + (c === '-' ? 1 : Number(c) || 0), 0) % 10;
}

/** Return the mistake of a line, or '' if its length and checksum are right. */
function mistakeOf(line: string, number: number): string {
  if (line.length !== 69) return `Line ${number} has ${line.length} characters, expected 69. Check the pasted line.`;
  const [got, expected] = [line[68], String(checksum(line))];
  return got === expected ? '' : `Line ${number} has the checksum ${got}, expected ${expected}. Check the pasted line.`;
}

/** Return the facts of a TLE with or without a name line, or the first mistake. */
export function readTle(text: string): TleFacts | string {
  const all = text
    .split('\n')
    .map((line) => line.trimEnd())
    .filter((line) => line.trim());
  const [first, second] = all.length === 3 ? all.slice(1) : all;
  if (!first?.startsWith('1 ') || !second?.startsWith('2 ') || all.length > 3)
    return 'Paste line 1 and line 2, with an optional name line before them.';
  const mistake = mistakeOf(first, 1) || mistakeOf(second, 2);
  if (mistake) return mistake;
  const year = Number(first.slice(18, 20));
  const epochMs =
    Date.UTC(year < 57 ? 2000 + year : 1900 + year, 0, 1) + (Number(first.slice(20, 32)) - 1) * 86_400_000;
  const radPerS = (Number(second.slice(52, 63)) * 2 * Math.PI) / 86_400;
  const [inclinationDeg, nodeDeg] = [Number(second.slice(8, 16)), Number(second.slice(17, 25))];
  const altitudeKm = Math.cbrt(MU_KM3_S2 / radPerS ** 2) - EARTH_RADIUS_KM;
  if (![epochMs, inclinationDeg, nodeDeg, altitudeKm].every(Number.isFinite))
    return 'A number is not in its columns. Check the pasted lines.';
  return { epoch: new Date(epochMs).toISOString(), inclinationDeg, nodeDeg, altitudeKm };
}

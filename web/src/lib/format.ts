/** Format numbers and times: true minus sign, narrow no-break space between digits, fixed decimals, UTC with Z. */

const MINUS = '\u2212';
const NARROW_SPACE = '\u202f'; // no line break in a number
export const NONE = '–';

function grouped(digits: string): string {
  return digits.length < 4 ? digits : digits.replace(/\B(?=(\d{3})+(?!\d))/g, NARROW_SPACE);
}

/** Format a number with fixed decimals. Null and NaN become a dash; `sign` adds + to positive numbers. */
export function fixed(value: number | null | undefined, decimals = 0, sign = false): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  const [whole = '0', part] = Math.abs(value).toFixed(decimals).split('.');
  const text = part === undefined ? grouped(whole) : `${grouped(whole)}.${part}`;
  const zero = Number(`${whole}.${part ?? 0}`) === 0;
  return (value < 0 && !zero ? MINUS : sign && !zero ? '+' : '') + text;
}

const HALF_ROTATION_ARCSEC = 180 * 3600;

/** Format the standard deviation of an angle: "2.1″". Above 180° it is "not determined". */
export function sigma(arcsec: number | null | undefined): string {
  if (arcsec === null || arcsec === undefined) return NONE;
  return arcsec > HALF_ROTATION_ARCSEC ? 'not determined' : `${fixed(arcsec, 1)}″`;
}

/** Format a count with its noun: "1 frame", "1 012 frames". */
export function counted(n: number, one: string, many = `${one}s`): string {
  return `${fixed(n)} ${n === 1 ? one : many}`;
}

/** Format a number with the fewest digits, at most six significant digits if it is not an integer. */
export function short(value: number | null | undefined): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  return Number.isInteger(value) ? fixed(value) : String(Number(value.toPrecision(6))).replace('-', MINUS);
}

/** Format a computed number beside a published one, with one decimal more than the publication gives. */
export function beside(value: number, published: unknown): string {
  if (typeof published !== 'number' || Number.isInteger(value) || Math.abs(published) < 1e-4) return short(value);
  return fixed(value, (String(published).split('.')[1] ?? '').length + 1);
}

export function degrees(value: number | null | undefined, decimals = 4, sign = false): string {
  return value === null || value === undefined ? NONE : `${fixed(value, decimals, sign)}°`;
}

export function scientific(value: number | null | undefined): string {
  if (value === null || value === undefined) return NONE;
  if (value === 0) return '0';
  return value.toExponential(0).replace('-', MINUS).replace('+', '');
}

/** Format a duration in the two largest suitable units: "12 s", "3 min 20 s", "2 d 4 h". */
export function span(seconds: number | null | undefined): string {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return NONE;
  const s = Math.max(0, seconds);
  if (s < 60) return `${s.toFixed(s < 10 ? 1 : 0)} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${Math.floor(s % 60)} s`;
  if (s < 86400) return `${Math.floor(s / 3600)} h ${Math.floor((s % 3600) / 60)} min`;
  return `${Math.floor(s / 86400)} d ${Math.floor((s % 86400) / 3600)} h`;
}

/** Format a duration in one unit, for narrow columns. */
export function brief(seconds: number): string {
  const s = Math.max(0, seconds);
  return s < 60
    ? span(s)
    : s < 3600
      ? `${Math.floor(s / 60)} min`
      : s < 86400
        ? `${Math.floor(s / 3600)} h`
        : `${Math.floor(s / 86400)} d`;
}

const SIGNS: Record<string, string> = { arcsec: '″', deg: '°', 'deg/s': '°/s' };

/** Return the unit as displayed beside a value. */
export function unitSign(unit: string): string {
  return SIGNS[unit] ?? unit;
}

/** Format an exposure in milliseconds with at least three significant digits: "0.25 ms", "120 ms", "1 500 ms". */
export function exposure(seconds: number): string {
  const ms = seconds * 1000;
  return `${ms >= 100 ? fixed(ms) : short(Number(ms.toPrecision(3)))} ms`;
}

/** Format the time of day in UTC, with Z. */
export function clock(iso: string | null | undefined, decimals = 0): string {
  if (!iso) return NONE;
  const text = new Date(iso).toISOString();
  return decimals ? `${text.slice(11, 20 + decimals)}Z` : `${text.slice(11, 19)}Z`;
}

export function day(iso: string | null | undefined): string {
  return iso ? new Date(iso).toISOString().slice(0, 10) : NONE;
}

export function utc(iso: string | null | undefined): string {
  return iso ? new Date(iso).toISOString() : NONE;
}

export function kib(bytes: number): string {
  return `${fixed(bytes / 1024, 1)} KiB`;
}

/** Format a number of bytes in the largest suitable binary unit (powers of 1024). */
export function bytes(n: number): string {
  const units = ['B', 'KiB', 'MiB', 'GiB', 'TiB'];
  const step = n > 0 ? Math.min(units.length - 1, Math.floor(Math.log2(n) / 10)) : 0;
  return `${fixed(n / 1024 ** step, step === 0 ? 0 : 1)} ${units[step] ?? ''}`;
}

/** Format disk space in decimal units (powers of 1000), as storage limits are entered. */
export function diskSize(n: number): string {
  const units = ['B', 'kB', 'MB', 'GB', 'TB'];
  const step = n > 0 ? Math.min(units.length - 1, Math.floor(Math.log10(n) / 3)) : 0;
  return `${fixed(n / 1000 ** step, step === 0 ? 0 : 1)} ${units[step] ?? ''}`;
}

export function hex(value: number): string {
  return value.toString(16);
}

export function shortHash(sha: string | null | undefined): string {
  return !sha ? NONE : sha.length <= 10 ? sha : `${sha.slice(0, 4)}…${sha.slice(-4)}`;
}

/** Split a hex string into bytes: "18 4d c0". */
export function pairs(hexText: string): string {
  return (hexText.replace(/\s/g, '').match(/../g) ?? []).join(' ');
}

/** Join the lines of a text that do not end with a sentence, because instrument packages wrap long lines. */
export function paragraphs(text: string): string {
  return text.replace(/([^.:;!?\s])\s*\n(?=\S)/g, '$1 ');
}

/** Return the name of a mode as words: "lost in space"; empty without a mode. */
export const modeWords = (mode: string | null): string => (mode ?? '').replace(/_/g, ' ');

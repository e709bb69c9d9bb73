/**
 * Parse a UTC time: "2026-12-01" or "2026-12-01 18:42", with optional T, seconds and Z. Returns null if it is invalid.
 */
export function parseUtcTime(text: string): string | null {
  const m = /^\s*(\d{4}-\d\d-\d\d)(?:[T ]+(\d\d:\d\d)(:\d\d)?)?\s*Z?\s*$/i.exec(text);
  const iso = m ? `${m[1] ?? ''}T${m[2] ?? '00:00'}${m[3] ?? ':00'}Z` : '';
  const time = Date.parse(iso);
  // A day beyond the end of the month is rejected and not carried into the next month.
  return Number.isFinite(time) && new Date(time).toISOString().slice(0, 10) === iso.slice(0, 10) ? iso : null;
}

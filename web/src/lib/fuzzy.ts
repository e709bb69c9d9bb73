/** Fuzzy search: all letters of the query in order; starts of words and consecutive letters score higher. */

const WORD = 8;
const RUN = 5;
const FIRST = 6;

/** Score of `query` in `text`; 0 if it does not match. An empty query matches everything with a low score. */
export function fuzzy(query: string, text: string): number {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  if (!words.length) return 1;
  const scores = words.map((w) => one(w, text.toLowerCase()));
  return scores.some((s) => s === 0) ? 0 : scores.reduce((a, b) => a + b, 0) / (1 + text.length / 200);
}

function one(query: string, text: string): number {
  const whole = place(query, text);
  if (whole >= 0 && starts(text, whole))
    return query.length * (RUN + 2) + WORD + (whole === 0 ? FIRST : 0) + (text.length === query.length ? WORD : 0);
  let score = 0;
  let from = 0;
  let last = -2;
  let initials = 0;
  for (const c of query) {
    const at = next(text, c, from, last);
    if (at < 0) return 0;
    score += 1 + (at === last + 1 ? RUN : 0) + (starts(text, at) ? WORD / 2 : 0);
    initials += Number(starts(text, at));
    last = at;
    from = at + 1;
  }
  if (initials === query.length) return query.length * RUN + WORD;
  return whole >= 0 ? query.length * RUN * 0.6 : score / 2;
}

/** Index of the whole query, at the start of a word if possible. */
function place(query: string, text: string): number {
  for (let at = text.indexOf(query); at >= 0; at = text.indexOf(query, at + 1)) if (starts(text, at)) return at;
  return text.indexOf(query);
}

/** The next position of a letter: right after the last one, else at the start of a word, else anywhere. */
function next(text: string, c: string, from: number, last: number): number {
  if (text[last + 1] === c && last >= 0) return last + 1;
  for (let i = from; i < text.length; i++) if (text[i] === c && starts(text, i)) return i;
  return text.indexOf(c, from);
}

function starts(text: string, at: number): boolean {
  return at === 0 || /[\s_\-./,:]/.test(text[at - 1] ?? '');
}

/** Best first; ties keep the given order. */
export function best<T>(query: string, list: readonly T[], textOf: (item: T) => string, most: number): T[] {
  return list
    .map((item, i) => ({ item, i, score: fuzzy(query, textOf(item)) }))
    .filter((s) => s.score > 0)
    .sort((a, b) => b.score - a.score || a.i - b.i)
    .slice(0, most)
    .map((s) => s.item);
}

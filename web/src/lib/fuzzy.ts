/**
 * Fuzzy search: a text matches if it contains all letters of the query in order. Starts of words and consecutive
 * letters score higher.
 */

const WORD = 8;
const RUN = 5;
const FIRST = 6;

/** Return the score of `query` in `text`; 0 if it does not match. An empty query matches every text with score 1. */
export function fuzzy(query: string, text: string): number {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  if (!words.length) return 1;
  const scores = words.map((w) => scoreWord(w, text.toLowerCase()));
  return scores.some((s) => s === 0) ? 0 : scores.reduce((a, b) => a + b, 0) / (1 + text.length / 200);
}

function scoreWord(query: string, text: string): number {
  const wholeAt = indexOfWhole(query, text);
  if (wholeAt >= 0 && isWordStart(text, wholeAt))
    return query.length * (RUN + 2) + WORD + (wholeAt === 0 ? FIRST : 0) + (text.length === query.length ? WORD : 0);
  let score = 0;
  let from = 0;
  let last = -2;
  let initials = 0;
  for (const c of query) {
    const at = indexOfLetter(text, c, from, last);
    if (at < 0) return 0;
    score += 1 + (at === last + 1 ? RUN : 0) + (isWordStart(text, at) ? WORD / 2 : 0);
    initials += Number(isWordStart(text, at));
    last = at;
    from = at + 1;
  }
  if (initials === query.length) return query.length * RUN + WORD;
  return wholeAt >= 0 ? query.length * RUN * 0.6 : score / 2;
}

/** Return the index of the whole query, at the start of a word if possible. */
function indexOfWhole(query: string, text: string): number {
  for (let at = text.indexOf(query); at >= 0; at = text.indexOf(query, at + 1)) if (isWordStart(text, at)) return at;
  return text.indexOf(query);
}

/**
 * Return the next index of a letter: directly after the last match, otherwise at the start of a word, otherwise
 * anywhere.
 */
function indexOfLetter(text: string, c: string, from: number, last: number): number {
  if (text[last + 1] === c && last >= 0) return last + 1;
  for (let i = from; i < text.length; i++) if (text[i] === c && isWordStart(text, i)) return i;
  return text.indexOf(c, from);
}

function isWordStart(text: string, at: number): boolean {
  return at === 0 || /[\s_\-./,:]/.test(text[at - 1] ?? '');
}

/** Minimum length of a word that may differ by a typing error. */
const MIN_LETTERS_WITH_ERROR = 4;

/**
 * True if each word of the query is the start of a word of the text or differs from a word by one typing error, and at
 * least one word has such an error.
 */
export function hasTypingError(query: string, text: string): boolean {
  const words = text.toLowerCase().split(/[\s_\-./,:]+/);
  const parts = query.toLowerCase().split(/\s+/).filter(Boolean);
  const wrong = parts.filter((part) => !words.some((word) => word.startsWith(part)));
  return wrong.length > 0 && wrong.every((part) => words.some((word) => differsByOne(part, word)));
}

/** True if one letter is missing, additional, wrong, or exchanged with the next letter. */
function differsByOne(text: string, word: string): boolean {
  if (text.length < MIN_LETTERS_WITH_ERROR) return false;
  let same = 0;
  while (same < text.length && text[same] === word[same]) same += 1;
  const [a, b] = [text.slice(same), word.slice(same)];
  const exchanged = a.length > 1 && a[0] === b[1] && a[1] === b[0] && a.slice(2) === b.slice(2);
  return a.slice(1) === b.slice(1) || a.slice(1) === b || a === b.slice(1) || exchanged;
}

/** Return the matching items, best first. Items with equal scores keep their order. */
export function best<T>(query: string, list: readonly T[], textOf: (item: T) => string, limit: number): T[] {
  return list
    .map((item, i) => ({ item, i, score: fuzzy(query, textOf(item)) }))
    .filter((s) => s.score > 0)
    .sort((a, b) => b.score - a.score || a.i - b.i)
    .slice(0, limit)
    .map((s) => s.item);
}

/** Return the text as a sentence with a capital letter and a period. An empty text stays empty. */
export function sentence(raw: string): string {
  const text = raw.trim();
  return text && `${text[0]?.toUpperCase()}${text.slice(1)}${/[.!?…]$/.test(text) ? '' : '.'}`;
}

/** Ranges of chunk numbers, both ends included, and the gaps between them. */
export type Range = readonly [number, number];

/** Return the gaps below the highest stored chunk. These chunks were lost; higher chunks are not sent yet. */
export function missingBelow(stored: readonly (readonly number[])[]): Range[] {
  const sorted = [...stored].map((r) => [r[0] ?? 0, r[1] ?? 0] as Range).sort((a, b) => a[0] - b[0]);
  const gaps: Range[] = [];
  let next = 0;
  for (const [first, last] of sorted) {
    if (first > next) gaps.push([next, first - 1]);
    next = Math.max(next, last + 1);
  }
  return gaps;
}

export function countOf(ranges: readonly Range[]): number {
  return ranges.reduce((sum, [a, b]) => sum + b - a + 1, 0);
}

export function rangesText(ranges: readonly Range[], limit = 3): string {
  const text = ranges.slice(0, limit).map(([a, b]) => (a === b ? `${a}` : `${a} – ${b}`));
  return text.join(', ') + (ranges.length > limit ? ' …' : '');
}

/** Parse frame numbers as users type them: "12-40, 45". */
export function parseIds(text: string): number[] {
  const out = new Set<number>();
  for (const part of text.split(/[\s,;]+/).filter(Boolean)) {
    const m = /^(\d+)(?:[-–](\d+))?$/.exec(part);
    if (!m) throw new Error(`not a number or a range: ${part}`);
    const [a, b] = [Number(m[1]), Number(m[2] ?? m[1])];
    if (b < a || b - a > 5000) throw new Error(`not a range: ${part}`);
    for (let k = a; k <= b; k++) out.add(k);
  }
  return [...out].sort((x, y) => x - y);
}

/** Return the frame numbers in a link of another page; none if the text is not a list. */
export function idsOf(text: string): number[] {
  try {
    return parseIds(text);
  } catch {
    return [];
  }
}

/** Return the shortest notation of the list. */
export function writeIds(ids: readonly number[]): string {
  const sorted = [...new Set(ids)].sort((a, b) => a - b);
  const runs: [number, number][] = [];
  for (const id of sorted) {
    const last = runs.at(-1);
    if (last && id === last[1] + 1) last[1] = id;
    else runs.push([id, id]);
  }
  return runs.map(([a, b]) => (a === b ? `${a}` : `${a}-${b}`)).join(', ');
}

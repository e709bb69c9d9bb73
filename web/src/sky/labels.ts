/**
 * Placement of labels beside marks. Of eight positions, the first free one is used; a label without a free position is
 * omitted.
 */
export interface Box {
  x: number;
  y: number;
  w: number;
  h: number;
  /** Reserved area: no label is placed here, not even the label of a mark inside it. */
  strict?: boolean;
}
/** A label to place: position of its mark, gap between mark and label, size, and rank (lowest first). */
export interface Want {
  key: string;
  x: number;
  y: number;
  gap: number;
  w: number;
  h: number;
  rank: number;
}
export interface Placed {
  key: string;
  x: number;
  y: number;
}

export function overlaps(a: Box, b: Box): boolean {
  return a.x < b.x + b.w && b.x < a.x + a.w && a.y < b.y + b.h && b.y < a.y + a.h;
}

function sides(want: Want): Box[] {
  const { x, y, gap, w, h } = want;
  const d = gap * 0.75;
  const at = (bx: number, by: number): Box => ({ x: bx, y: by, w, h });
  return [
    at(x + gap, y - h / 2),
    at(x - gap - w, y - h / 2),
    at(x - w / 2, y + gap),
    at(x - w / 2, y - gap - h),
    at(x + d, y + d - h / 2),
    at(x + d, y - d - h / 2),
    at(x - d - w, y + d - h / 2),
    at(x - d - w, y - d - h / 2),
  ];
}

/**
 * Return the top-left positions of the labels that fit, lowest rank first. A label never covers a mark except its own.
 */
export function placeLabels(wants: readonly Want[], marks: readonly Box[], area: Box): Placed[] {
  const taken: Box[] = [];
  const placed: Placed[] = [];
  for (const want of [...wants].sort((a, b) => a.rank - b.rank)) {
    const free = sides(want).find(
      (b) =>
        inside(b, area) &&
        !taken.some((t) => overlaps(t, b)) &&
        !marks.some((m) => overlaps(m, b) && !isOwnMark(m, want)),
    );
    if (!free) continue;
    taken.push(free);
    placed.push({ key: want.key, x: free.x, y: free.y });
  }
  return placed;
}

function isOwnMark(mark: Box, want: Want): boolean {
  return !mark.strict && want.x >= mark.x && want.x <= mark.x + mark.w && want.y >= mark.y && want.y <= mark.y + mark.h;
}

function inside(b: Box, area: Box): boolean {
  return b.x >= area.x && b.y >= area.y && b.x + b.w <= area.x + area.w && b.y + b.h <= area.y + area.h;
}

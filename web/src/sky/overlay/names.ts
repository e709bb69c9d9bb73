/** Labels beside the marks, placed without overlap: names, magnitudes, and why a region was rejected. */
import { fixed } from '../../lib/format';
import { placeLabels, type Box, type Want } from '../labels';
import { at, corners, halo, seen, type Colour, type Ctx, type Scene, type Screen } from './screen';
import { medianMatchedFlux } from './stars';

interface Text {
  parts: { text: string; ink: string }[][];
}

export function labels(
  ctx: Ctx,
  s: Screen,
  scene: Scene,
  main: ReadonlySet<number>,
  photo: Box,
  gridLabels: readonly Box[],
  colour: Colour,
): void {
  const { solution: sol, show } = scene;
  if (!sol) return;
  ctx.font = "11.5px 'IBM Plex Sans'";
  const texts = new Map<string, Text>();
  const wants: Want[] = [];
  const marks: Box[] = [...corners(s), ...gridLabels];
  const minFlux = medianMatchedFlux(sol);
  const add = (key: string, col: number, row: number, rank: number, parts: Text['parts'], gap = 14): void => {
    const [x, y] = at(s, col, row);
    if (!seen(s, x, y)) return;
    const w = Math.max(...parts.map((line) => line.reduce((sum, p) => sum + ctx.measureText(p.text).width, 0)));
    texts.set(key, { parts });
    wants.push({ key, x, y, gap, w, h: 14 * parts.length, rank });
  };
  for (const star of sol.stars) {
    if (!main.has(star.index) && scene.selected !== star.index) continue;
    const [x, y] = at(s, star.col_px, star.row_px);
    if (star.hip !== null || star.flux_dn >= minFlux) marks.push({ x: x - 10, y: y - 10, w: 20, h: 20 });
    if (!show.matched) continue;
    if (star.hip === null && star.name === null) {
      if (star.flux_dn >= minFlux)
        add(`c${star.index}`, star.col_px, star.row_px, 6, [[{ text: 'no match', ink: colour('ov-nomatch') }]]);
    } else
      add(`s${star.index}`, star.col_px, star.row_px, star.v_mag ?? 5, [
        [
          { text: `${star.name ?? `HIP ${star.hip}`} `, ink: colour('ov-txt') },
          { text: fixed(star.v_mag, 2), ink: colour('ov-mag') },
        ],
      ]);
  }
  const undetected = sol.predicted.filter((p) => !p.detected);
  for (const p of undetected) {
    const region = show.rejected
      ? sol.regions.find(
          (r) =>
            r.rejected &&
            p.col_px > r.col_min - 4 &&
            p.col_px < r.col_max + 4 &&
            p.row_px > r.row_min - 4 &&
            p.row_px < r.row_max + 4,
        )
      : undefined;
    const showReason = region && (p.v_mag < 1.5 || s.scale >= 2);
    const ink = showReason ? colour('ov-txt') : colour('ov-pred');
    const lines: Text['parts'] = [
      [
        { text: `${p.name} `, ink },
        { text: fixed(p.v_mag, 2), ink: colour('ov-mag') },
      ],
    ];
    if (showReason && region) lines.push([{ text: `rejected: ${region.rejected}`, ink: colour('ov-rej') }]);
    if (show.predicted || showReason) add(`p${p.hip}`, p.col_px, p.row_px, showReason ? -3 : p.v_mag + 2, lines, 15);
  }
  const area = { x: photo.x + 2, y: photo.y + 2, w: photo.w - 4, h: photo.h - 4 };
  for (const placed of placeLabels(wants, marks, area)) {
    texts.get(placed.key)?.parts.forEach((line, i) => {
      let x = placed.x;
      for (const part of line) {
        halo(ctx, part.text, x, placed.y + 11 + 14 * i, part.ink, colour('ov-halo'));
        x += ctx.measureText(part.text).width;
      }
    });
  }
}

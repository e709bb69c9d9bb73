/** Hatch the rows and parts that were not received. They are never drawn black. */
import type { Frame } from '../../api/types';
import type { Ctx, Screen } from './screen';

export function missingRows(ctx: Ctx, s: Screen, frame: Frame, colour: string): void {
  if (frame.complete) return;
  if (frame.held.length) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(s.x, s.y, frame.columns * s.scale, frame.rows * s.scale);
    for (const [col, row, columns, rows] of frame.held)
      ctx.rect(s.x + col * s.scale, s.y + row * s.scale, columns * s.scale, rows * s.scale);
    ctx.clip('evenodd');
    hatch(ctx, s.x, s.y, frame.columns * s.scale, frame.rows * s.scale, colour);
    ctx.restore();
    return;
  }
  let next = 0;
  const held = [...frame.rows_held].sort((a, b) => a[0] - b[0]);
  for (const [first, last] of [...held, [frame.rows, frame.rows] as [number, number]]) {
    if (first > next) hatch(ctx, s.x, s.y + next * s.scale, frame.columns * s.scale, (first - next) * s.scale, colour);
    next = Math.max(next, last + 1);
  }
}

export function hatch(ctx: Ctx, x: number, y: number, w: number, h: number, colour: string): void {
  ctx.save();
  ctx.beginPath();
  ctx.rect(x, y, w, h);
  ctx.clip();
  ctx.strokeStyle = colour;
  ctx.globalAlpha = 0.55;
  ctx.beginPath();
  for (let d = -h; d < w; d += 6) {
    ctx.moveTo(x + d, y + h);
    ctx.lineTo(x + d + h, y);
  }
  ctx.stroke();
  ctx.restore();
}

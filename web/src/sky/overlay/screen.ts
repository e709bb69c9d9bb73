/**
 * Shared functions of the overlays: screen position of a pixel, visibility, and text that is readable on any
 * background.
 */
import type { Frame, SolutionDetail } from '../../api/types';
import type { RawImage } from '../../api/pixels';
import type { Overlay } from '../../state/view.svelte';
import type { Box } from '../labels';

export interface Screen {
  scale: number;
  x: number;
  y: number;
  width: number;
  height: number;
}
export interface Scene {
  frame: Frame;
  image: RawImage | null;
  solution: SolutionDetail | null;
  show: Record<Overlay, boolean>;
  selected: number | null;
  residualFactor: number;
}
export type Ctx = CanvasRenderingContext2D;
export type Colour = (name: string) => string;

export const at = (s: Screen, col: number, row: number): [number, number] => [
  s.x + (col + 0.5) * s.scale,
  s.y + (row + 0.5) * s.scale,
];
export const seen = (s: Screen, x: number, y: number): boolean =>
  x > -20 && y > -20 && x < s.width + 20 && y < s.height + 20;

/** Return the part of the canvas that the image covers. */
export function picture(s: Screen, frame: Frame): Box {
  const [x, y] = [Math.max(0, s.x), Math.max(0, s.y)];
  return {
    x,
    y,
    w: Math.min(s.width, s.x + frame.columns * s.scale) - x,
    h: Math.min(s.height, s.y + frame.rows * s.scale) - y,
  };
}

/** Return the reserved corners: compass and roll on the left, scale bar on the right. */
export function corners(s: Screen): Box[] {
  return [
    { x: 0, y: s.height - 114, w: 112, h: 114, strict: true },
    { x: s.width * 0.82, y: s.height - 32, w: s.width * 0.18, h: 32, strict: true },
  ];
}

export function halo(ctx: Ctx, text: string, x: number, y: number, ink: string, ground: string): void {
  ctx.save();
  ctx.lineJoin = 'round';
  ctx.lineWidth = 3;
  ctx.strokeStyle = ground;
  ctx.strokeText(text, x, y);
  ctx.fillStyle = ink;
  ctx.fillText(text, x, y);
  ctx.restore();
}

/** Draw a background behind a line of text, so that marks do not cross its letters. */
export function plate(ctx: Ctx, text: string, x: number, y: number, ground: string): void {
  ctx.save();
  ctx.globalAlpha = 0.82;
  ctx.fillStyle = ground;
  ctx.fillRect(x - 4, y - 12, ctx.measureText(text).width + 8, 16);
  ctx.restore();
}

/** uPlot options for a stack of plots with limits, gaps, cursor and zoom by dragging. */
import uPlot from 'uplot';
import type { FieldDefinition, History } from '../../api/types';
import { fixed, unitSign } from '../../lib/format';
import type { Gap } from './gaps';

export type Series = History['series'][number];
type Css = (name: string) => string;
export interface PlotParts {
  css: Css;
  width: number;
  height: number;
  last: boolean;
  group: readonly Series[];
  fields: readonly (FieldDefinition | undefined)[];
  span: () => [number, number];
  gaps: () => readonly Gap[];
  cursor: (at: number | null) => void;
  zoom: (from: number, to: number) => void;
}
export const LEFT = 52;
export const RIGHT = 64;
const FONT = "11px 'IBM Plex Sans'";
/** Smallest distance of the labels of the time axis, which have up to nine characters. */
const TIME_PX = 72;
/** Colours and dashes: first series in the accent colour, second series grey, others light and dashed. */
export const INKS: readonly [string, number[]][] = [
  ['ac', []],
  ['tx2', []],
  ['t4', [5, 3]],
];

export function options(p: PlotParts): uPlot.Options {
  const words = p.group[0]?.choices ?? [];
  const clock = (ts: number[]): string[] => ts.map((t) => (p.last ? timeText(t, p.span()) : ''));
  return {
    width: p.width,
    height: p.height,
    legend: { show: false },
    padding: [22, RIGHT, 0, 0],
    tzDate: (s) => uPlot.tzDate(new Date(s * 1000), 'Etc/UTC'),
    cursor: { sync: { key: 'telemetry' }, points: { size: 6 }, drag: { x: true, y: false, setScale: false } },
    scales: {
      x: { time: true, range: () => p.span() },
      y: { range: (_u, low, high) => yRange(low, high, p.fields[0]) },
    },
    axes: [
      {
        show: true,
        size: p.last ? 26 : 6,
        space: TIME_PX,
        stroke: p.css('tx3'),
        font: FONT,
        grid: { stroke: p.css('ln1'), width: 1 },
        ticks: { show: false },
        values: (_u, ts) => clock(ts),
      },
      {
        size: LEFT,
        stroke: p.css('tx3'),
        font: FONT,
        grid: { stroke: p.css('ln1'), width: 1 },
        ticks: { show: false },
        values: (_u, vs) =>
          words.length ? vs.map((v) => words.find((w) => w.value === v)?.name.slice(0, 9) ?? '') : axisTexts(vs),
      },
    ],
    series: [
      {},
      ...p.group.map((_s, i) => ({
        stroke: p.css(INKS[i]?.[0] ?? 't4'),
        dash: INKS[i]?.[1] ?? [],
        width: 1.2,
        spanGaps: false,
        points: { show: false },
      })),
    ],
    hooks: {
      drawClear: [(u) => hatch(u, p)],
      drawAxes: [(u) => limits(u, p.fields[0], p.css)],
      setCursor: [
        (u) => p.cursor(u.cursor.left === undefined || u.cursor.left < 0 ? null : u.posToVal(u.cursor.left, 'x')),
      ],
      setSelect: [
        (u) => {
          if (u.select.width < 4) return;
          p.zoom(u.posToVal(u.select.left, 'x'), u.posToVal(u.select.left + u.select.width, 'x'));
          u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        },
      ],
    },
  };
}

/** Return the range of the y axis: the values and nearby limits, with a margin. */
export function yRange(low: number | null, high: number | null, f: FieldDefinition | undefined): [number, number] {
  if (low === null || high === null || !Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
  const near = Math.max(high - low, 0.35 * Math.max(Math.abs(low), Math.abs(high)));
  const lines = [...(f?.watch ?? []), ...(f?.warning ?? []), ...(f?.critical ?? [])].filter(
    (v): v is number => v !== null && v >= low - near && v <= high + near,
  );
  const [a, b] = [Math.min(low, ...lines), Math.max(high, ...lines)];
  const air = (b - a || Math.abs(b) || 1) * 0.06;
  return [a >= 0 && a - air < 0 ? 0 : a - air, b + air];
}

/** Format the axis values with the decimals of the grid step, so that steps of 0.25 are not shown as 0.3, 0.5, 0.8. */
export function axisTexts(vs: number[]): string[] {
  const step = Math.abs((vs[1] ?? 1) - (vs[0] ?? 0));
  const decimals = [0, 1, 2, 3].find((d) => Math.abs(step * 10 ** d - Math.round(step * 10 ** d)) < 1e-6) ?? 3;
  return vs.map((v) => fixed(v, step < 0.001 ? 4 : decimals));
}

export function timeText(t: number, [from, to]: readonly [number, number]): string {
  const iso = new Date(t * 1000).toISOString();
  return to - from > 86_400
    ? `${iso.slice(5, 10)} ${iso.slice(11, 16)}`
    : to - from > 1200
      ? `${iso.slice(11, 16)}Z`
      : `${iso.slice(11, 19)}Z`;
}

/**
 * Draw the limits of the first series: watch dotted, warning dashed, critical solid. Level and value are at the right;
 * labels that would overlap are omitted.
 */
function limits(u: uPlot, f: FieldDefinition | undefined, css: Css): void {
  const { ctx, bbox } = u;
  const ratio = devicePixelRatio;
  const taken: number[] = [];
  ctx.save();
  ctx.lineWidth = ratio;
  ctx.textBaseline = 'middle';
  ctx.textAlign = 'left'; // Reset the text alignment that uPlot has set.
  ctx.font = `${11 * ratio}px 'IBM Plex Sans'`;
  for (const [name, pair, dash, ink] of [
    ['crit', f?.critical, [], 'crit'],
    ['warn', f?.warning, [5, 4], 'warn'],
    ['watch', f?.watch, [2, 3], 'watch'],
  ] as const) {
    for (const v of pair ?? []) {
      if (v === null) continue;
      const y = u.valToPos(v, 'y', true);
      if (y < bbox.top || y > bbox.top + bbox.height) continue;
      ctx.strokeStyle = ctx.fillStyle = css(ink);
      ctx.globalAlpha = 0.6;
      ctx.setLineDash(dash.map((d) => d * ratio));
      ctx.beginPath();
      ctx.moveTo(bbox.left, y);
      ctx.lineTo(bbox.left + bbox.width, y);
      ctx.stroke();
      ctx.globalAlpha = 1;
      if (taken.some((t) => Math.abs(t - y) < 12 * ratio)) continue;
      taken.push(y);
      ctx.fillText(`${name} ${v}`.replace('-', '−'), bbox.left + bbox.width + 6 * ratio, y);
    }
  }
  ctx.restore();
}

/** Hatch the gaps. A gap is labelled with its length if there is space. */
function hatch(u: uPlot, p: PlotParts): void {
  const { ctx, bbox } = u;
  const ratio = devicePixelRatio;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.strokeStyle = ctx.fillStyle = p.css('unk');
  ctx.lineWidth = ratio;
  ctx.textAlign = 'left';
  ctx.textBaseline = 'alphabetic';
  ctx.font = `${11 * ratio}px 'IBM Plex Sans'`;
  let labelEnd = -Infinity;
  for (const g of p.gaps()) {
    const [a, b] = [u.valToPos(g.from, 'x', true), u.valToPos(g.to, 'x', true)];
    if (b < bbox.left || a > bbox.left + bbox.width) continue;
    ctx.save();
    ctx.beginPath();
    ctx.rect(a, bbox.top, Math.max(3 * ratio, b - a), bbox.height);
    ctx.clip();
    ctx.globalAlpha = 0.45;
    ctx.beginPath();
    for (let x = a - bbox.height; x < b + 4; x += 6 * ratio) {
      ctx.moveTo(x, bbox.top + bbox.height);
      ctx.lineTo(x + bbox.height, bbox.top);
    }
    ctx.stroke();
    ctx.restore();
    if (p.last) {
      const seconds = g.to - g.from;
      const text = seconds < 100 ? `no data ${fixed(seconds)} s` : `no data ${fixed(seconds / 60)} min`;
      const wide = ctx.measureText(text).width;
      const before = a - wide - 4 * ratio;
      const at = before > Math.max(bbox.left, labelEnd) ? before : b + 4 * ratio;
      if (at <= labelEnd || at + wide > bbox.left + bbox.width) continue;
      ctx.fillText(text, at, bbox.top + bbox.height - 6 * ratio);
      labelEnd = at + wide + 6 * ratio;
    }
  }
  ctx.restore();
}

/** Return name and value of a series at the cursor, or its latest value: "Sensor temperature °C" and "45.0". */
export function reading(s: Series, f: FieldDefinition | undefined, at: number | null): { name: string; value: string } {
  let i = s.t.length - 1;
  if (at !== null) {
    while (i > 0 && (s.t[i] ?? 0) > at) i -= 1;
  } else while (i > 0 && s.y[i] === null) i -= 1;
  const y = s.y[i] ?? null;
  const word = s.choices.find((c) => c.value === y)?.name;
  return {
    name: `${f?.title || s.title || s.name} ${unitSign(s.unit)}`.trim(),
    value: word ?? fixed(y, f?.decimals ?? 2),
  };
}

import { readFileSync } from 'node:fs';
import { describe, expect, it } from 'vitest';

const css = readFileSync(new URL('./tokens.css', import.meta.url), 'utf8');

function tokens(theme: 'dark' | 'light'): Record<string, string> {
  const block = css.slice(css.indexOf(`[data-theme='${theme}'] {`)).split('}')[0] ?? '';
  return Object.fromEntries([...block.matchAll(/--([\w-]+):\s*(#[0-9a-f]{6})/gi)].map((m) => [m[1] ?? '', m[2] ?? '']));
}
function luminance(hex: string): number {
  const [r, g, b] = [1, 3, 5]
    .map((i) => parseInt(hex.slice(i, i + 2), 16) / 255)
    .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)) as [number, number, number];
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}
function contrast(a: string, b: string): number {
  const [x, y] = [luminance(a), luminance(b)].sort((p, q) => q - p) as [number, number];
  return (x + 0.05) / (y + 0.05);
}

const STATES = ['ok', 'watch', 'warn', 'crit', 'unk'];
describe.each([
  ['dark', 4.7, 8.5],
  ['light', 4.85, 6.0],
] as const)('%s tokens', (theme, smallest, onAccent) => {
  const t = tokens(theme);
  const of = (a: string, b: string): number => contrast(t[a] ?? '', t[b] ?? '');
  const grounds = ['bg1', 'bg2', 'bg3', 'sel'];
  it('keeps every text and the accent readable on every background of text', () => {
    const pairs = ['tx1', 'tx2', 'tx3', 'ac'].flatMap((a) =>
      grounds.filter((g) => !(g === 'sel' && a === 'ac')).map((g) => of(a, g)),
    );
    expect(Math.min(...pairs)).toBeGreaterThanOrEqual(smallest - 0.005);
  });
  it('gives values a contrast of at least 12.8 on every background', () => {
    expect(Math.min(...grounds.map((g) => of('tx1', g)))).toBeGreaterThanOrEqual(12.795);
  });
  it('gives state words at least 5.7 on panels and 5.0 on their tint', () => {
    expect(Math.min(...STATES.map((s) => of(s, 'bg1')))).toBeGreaterThanOrEqual(5.695);
    expect(Math.min(...STATES.map((s) => of(s, `${s}Bg`)))).toBeGreaterThanOrEqual(4.995);
  });
  it('gives text on the accent and on ABORT the contrast of the design', () => {
    expect(of('acInk', 'ac')).toBeCloseTo(onAccent, 1);
    expect(of('onCrit', 'critFill')).toBeCloseTo(6.65, 2);
  });
  it('draws control borders with at least 3.2 on every panel background', () => {
    expect(Math.min(...['bg1', 'bg2', 'bg3'].map((g) => of('edge', g)))).toBeGreaterThanOrEqual(3.195);
  });
  it('defines every token of the table', () => {
    expect(Object.keys(t)).toEqual(
      expect.arrayContaining([
        'bg0',
        'bg1',
        'bg2',
        'bg3',
        'sel',
        'ln1',
        'ln2',
        'edge',
        'tx1',
        'tx2',
        'tx3',
        'ac',
        'acInk',
        'critFill',
        'onCrit',
        't1',
        't5',
        'idle',
        'chart',
        'star',
      ]),
    );
  });
});

import { runInNewContext } from 'node:vm';
import { readFileSync } from 'node:fs';
import { expect, it } from 'vitest';
import { themeOf } from './theme';

const HELP = readFileSync('public/help.js', 'utf8');

/** Return the theme of a help page. */
function themeOfHelp(chosen: string | null, prefersDark: boolean): string | undefined {
  const dataset: { theme?: string } = {};
  runInNewContext(HELP, {
    document: { documentElement: { dataset } },
    localStorage: { getItem: () => chosen },
    matchMedia: () => ({ matches: prefersDark }),
  });
  return dataset.theme;
}

it.each([
  [null, true, 'dark'],
  [null, false, 'light'],
  ['light', true, 'light'],
  ['dark', false, 'dark'],
  ['blue', false, 'light'],
])('is the chosen one (%s), otherwise that of the browser (dark: %s)', (chosen, prefersDark, theme) => {
  expect(themeOf(chosen, prefersDark)).toBe(theme);
  expect(themeOfHelp(chosen, prefersDark)).toBe(theme);
});

/** Theme of the console. public/help.js applies the same rule to the help pages. */
export type Theme = 'dark' | 'light';

/** Return the theme that the user chose, otherwise the one of the browser's colour scheme. */
export function themeOf(chosen: string | null, prefersDark: boolean): Theme {
  if (chosen === 'dark' || chosen === 'light') return chosen;
  return prefersDark ? 'dark' : 'light';
}

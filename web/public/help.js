// The theme that was chosen in the console, otherwise the one of the browser's colour scheme; see src/lib/theme.ts.
const chosenTheme = localStorage.getItem('gss-theme');
const browserTheme = matchMedia('(prefers-color-scheme: dark)').matches ? 'dark' : 'light';
document.documentElement.dataset.theme = ['dark', 'light'].includes(chosenTheme) ? chosenTheme : browserTheme;

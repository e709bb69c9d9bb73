import svelte from 'eslint-plugin-svelte';
import globals from 'globals';
import ts from 'typescript-eslint';
import svelteConfig from './svelte.config.js';

export default ts.config(
  { ignores: ['dist/', 'src/api/generated/', 'public/'] },
  ...ts.configs.recommended,
  ...svelte.configs['flat/recommended'],
  ...svelte.configs['flat/prettier'],
  { languageOptions: { globals: { ...globals.browser, ...globals.node } } },
  {
    files: ['**/*.svelte', '**/*.svelte.ts'],
    languageOptions: { parserOptions: { parser: ts.parser, extraFileExtensions: ['.svelte'], svelteConfig } },
  },
  {
    rules: {
      'max-len': ['error', { code: 120 }],
      'max-lines': ['warn', 350],
      'svelte/prefer-svelte-reactivity': 'off', // states are raw: collections are replaced, never changed in place
      'svelte/no-useless-mustaches': 'off', // {' '} is a space that the formatter keeps
      'svelte/no-unused-svelte-ignore': 'off', // svelte-check needs the comments that the plugin's parser does not
    },
  },
);

import { svelte } from '@sveltejs/vite-plugin-svelte';
import { defineConfig } from 'vitest/config';

// A test that imports a whole module graph takes seconds on a busy machine.
const test = { include: ['src/**/*.test.ts'], environment: 'node', testTimeout: 60_000 } as const;

export default defineConfig({ plugins: [svelte()], test });

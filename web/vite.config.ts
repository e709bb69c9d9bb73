import { svelte } from '@sveltejs/vite-plugin-svelte';
import { defineConfig } from 'vite';

const api = process.env['GSS_API'] ?? 'http://127.0.0.1:8181';

/** The server answers changes only from its own origin: under development the proxy stands for it. */
const proxy = { '/api': { target: api, changeOrigin: true, headers: { origin: api } } };

export default defineConfig({
  plugins: [svelte()],
  build: {
    outDir: '../gss/web',
    emptyOutDir: true,
    target: 'es2022',
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 700,
    rolldownOptions: { checks: { bundlerTimings: false } },
  },
  server: { host: '127.0.0.1', proxy },
  preview: { host: '127.0.0.1', proxy },
});

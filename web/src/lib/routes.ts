/** Which page stands at which address. A page is a file of pages/, fetched when it is first shown; Live comes with the first view. */
import type { Component } from 'svelte';

export interface Match { file: string; props: Record<string, unknown> }
interface Route { path: string; file: string }

/** `:id` is a whole number and becomes a property of the page. First match wins. Set-up, welcome and sign-in stand before all of this, in Gate. */
const ROUTES: readonly Route[] = [
  { path: '/live', file: 'Live' },
  { path: '/commands', file: 'Commands' },
  { path: '/telemetry', file: 'Telemetry' },
  { path: '/frames', file: 'Frames' },
  { path: '/frames/:id', file: 'FrameDetail' },
  { path: '/catalogues', file: 'Catalogues' },
  { path: '/catalogues/design', file: 'Design' },
  { path: '/catalogues/new', file: 'CatalogueBuilder' },
  { path: '/catalogues/:id', file: 'CatalogueBuilder' },
  { path: '/calibration', file: 'Calibration' },
  { path: '/campaigns', file: 'Campaigns' },
  { path: '/contacts', file: 'Contacts' },
  { path: '/contacts/:id', file: 'Contacts' },
  { path: '/admin', file: 'Admin' },
  { path: '/rerun', file: 'Rerun' },
];
/** Pages that want their `id` even where the address has none. */
const ID_OR_NULL = new Set(['CatalogueBuilder', 'Contacts']);

export function matchRoute(path: string): Match | null {
  const parts = path.replace(/\/+$/, '').split('/');
  for (const r of ROUTES) {
    const wanted = r.path.split('/');
    if (wanted.length !== parts.length) continue;
    let id: number | null = null;
    const fits = wanted.every((w, i) => {
      const part = parts[i] ?? '';
      if (w !== ':id') return w === part;
      id = /^\d+$/.test(part) ? Number(part) : null;
      return id !== null;
    });
    if (fits) return { file: r.file, props: id !== null || ID_OR_NULL.has(r.file) ? { id } : {} };
  }
  return null;
}

type PageModule = { default: Component<Record<string, unknown>> };
const FILES = import.meta.glob<PageModule>(['../pages/*.svelte', '!../pages/Live.svelte']);

export function hasPage(file: string): boolean {
  return file === 'Live' || `../pages/${file}.svelte` in FILES;
}

export async function fetchPage(file: string): Promise<PageModule['default']> {
  const read = FILES[`../pages/${file}.svelte`];
  if (!read) throw new Error(`there is no page ${file}`);
  return (await read()).default;
}

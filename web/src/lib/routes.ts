/**
 * URLs and their pages. Each page is a folder in pages/ and is fetched when it is first shown; Live is part of the
 * first download.
 */
import type { Component } from 'svelte';

export interface Match {
  page: string;
  props: Record<string, unknown>;
}
interface Route {
  path: string;
  page: string;
}

/**
 * `:id` is an integer and becomes a property of the page. The first match applies. Gate shows set-up, welcome and
 * sign-in.
 */
const ROUTES: readonly Route[] = [
  { path: '/fleet', page: 'fleet' },
  { path: '/live', page: 'live' },
  { path: '/commands', page: 'commands' },
  { path: '/procedures', page: 'procedures' },
  { path: '/telemetry', page: 'telemetry' },
  { path: '/telemetry/derived', page: 'derived' },
  { path: '/frames', page: 'frames' },
  { path: '/frames/lists', page: 'lists' },
  { path: '/frames/:id', page: 'frame' },
  { path: '/catalogues', page: 'catalogues' },
  { path: '/catalogues/design', page: 'design' },
  { path: '/catalogues/new', page: 'builder' },
  { path: '/catalogues/:id', page: 'builder' },
  { path: '/stars/:id', page: 'star' },
  { path: '/calibration', page: 'calibration' },
  { path: '/sheet', page: 'sheet' },
  { path: '/campaigns', page: 'campaigns' },
  { path: '/contacts', page: 'contacts' },
  { path: '/contacts/:id', page: 'contacts' },
  { path: '/passes', page: 'passes' },
  { path: '/admin', page: 'admin' },
  { path: '/instruments', page: 'instruments' },
  { path: '/rerun', page: 'rerun' },
  { path: '/views', page: 'views' },
  { path: '/views/:id', page: 'views' },
];
/** Pages that receive `id: null` if the URL has none. */
const ID_OR_NULL = new Set(['builder', 'contacts', 'views']);

export function matchRoute(path: string): Match | null {
  const parts = path.replace(/\/+$/, '').split('/');
  for (const r of ROUTES) {
    const pattern = r.path.split('/');
    if (pattern.length !== parts.length) continue;
    let id: number | null = null;
    const matches = pattern.every((expected, i) => {
      const part = parts[i] ?? '';
      if (expected !== ':id') return expected === part;
      id = /^\d+$/.test(part) ? Number(part) : null;
      return id !== null;
    });
    if (matches) return { page: r.page, props: id !== null || ID_OR_NULL.has(r.page) ? { id } : {} };
  }
  return null;
}

type PageModule = { default: Component<Record<string, unknown>> };
const FILES = import.meta.glob<PageModule>(['../pages/*/Page.svelte', '!../pages/live/Page.svelte']);

export function hasPage(page: string): boolean {
  return page === 'live' || `../pages/${page}/Page.svelte` in FILES;
}

export async function fetchPage(page: string): Promise<PageModule['default']> {
  const read = FILES[`../pages/${page}/Page.svelte`];
  if (!read) throw new Error(`there is no page ${page}`);
  return (await read()).default;
}

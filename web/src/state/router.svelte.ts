/** Routing with the History API: each state of the console has a URL. */
import { base, localPath } from '../lib/base';

export const route = $state({ path: localPath(location.pathname) ?? '/', search: location.search });

function read(): void {
  route.path = localPath(location.pathname) ?? '/';
  route.search = location.search;
}

/** Go to a path of this console. The base path of its unit is added. */
export function go(to: string, replace = false): void {
  if (replace) history.replaceState(null, '', base + to);
  else history.pushState(null, '', base + to);
  read();
}

export function query(name: string): string {
  return new URLSearchParams(route.search).get(name) ?? '';
}

/** Set or clear one query parameter of the present URL, without a history entry. */
export function setQuery(name: string, value: string): void {
  const q = new URLSearchParams(location.search);
  if (value) q.set(name, value);
  else q.delete(name);
  const text = q.toString();
  go(route.path + (text ? `?${text}` : ''), true);
}

export function startRouter(): void {
  addEventListener('popstate', read);
  document.addEventListener('click', (e) => {
    const a = e.target instanceof Element ? e.target.closest('a') : null;
    if (
      !a ||
      e.defaultPrevented ||
      e.button !== 0 ||
      e.metaKey ||
      e.ctrlKey ||
      e.shiftKey ||
      a.target ||
      a.hasAttribute('download')
    )
      return;
    const path = localPath(a.pathname);
    if (a.origin !== location.origin || path === null || path.startsWith('/api/')) return;
    e.preventDefault();
    go(path + a.search);
  });
}

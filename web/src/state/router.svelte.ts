/** URLs of the History API: every state of the console has a link. */
import { base, inside } from '../lib/base';

export const route = $state({ path: inside(location.pathname) ?? '/', search: location.search });

function read(): void {
  route.path = inside(location.pathname) ?? '/';
  route.search = location.search;
}

/** Goes to a path of this console; the base of its unit is put before it. */
export function go(to: string, replace = false): void {
  if (replace) history.replaceState(null, '', base + to);
  else history.pushState(null, '', base + to);
  read();
}

export function query(name: string): string {
  return new URLSearchParams(route.search).get(name) ?? '';
}

/** Sets or clears one query parameter of the present URL without a history entry. */
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
    const path = inside(a.pathname);
    if (a.origin !== location.origin || path === null || path.startsWith('/api/')) return;
    e.preventDefault();
    go(path + a.search);
  });
  if (route.path === '/') go('/live', true);
}

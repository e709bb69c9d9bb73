/** Paths of the History API: every state of the console is a link. */
export const route = $state({ path: location.pathname, search: location.search });

function read(): void {
  route.path = location.pathname;
  route.search = location.search;
}

export function go(to: string, replace = false): void {
  if (replace) history.replaceState(null, '', to);
  else history.pushState(null, '', to);
  read();
}

export function query(name: string): string {
  return new URLSearchParams(route.search).get(name) ?? '';
}

/** Sets or clears one query parameter of the present address without adding to the history. */
export function setQuery(name: string, value: string): void {
  const q = new URLSearchParams(location.search);
  if (value) q.set(name, value);
  else q.delete(name);
  const text = q.toString();
  go(location.pathname + (text ? `?${text}` : ''), true);
}

export function startRouter(): void {
  addEventListener('popstate', read);
  document.addEventListener('click', (e) => {
    const a = e.target instanceof Element ? e.target.closest('a') : null;
    if (!a || e.defaultPrevented || e.button !== 0 || e.metaKey || e.ctrlKey || e.shiftKey || a.target || a.hasAttribute('download')) return;
    if (a.origin !== location.origin || a.pathname.startsWith('/api/')) return;
    e.preventDefault();
    go(a.pathname + a.search);
  });
  if (location.pathname === '/') go('/live', true);
}

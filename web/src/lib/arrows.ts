/**
 * Keyboard navigation: each table or list is one tab stop; the arrow keys, Home and End move inside it. One listener
 * serves all tables and lists below an element, including those added later. Controls in forms keep separate tab stops,
 * because the arrow keys move the text cursor in fields.
 */
const GROUPS = 'table, [role="listbox"], [data-arrows]';
const CONTROLS = 'a[href], button:not(:disabled), [role="option"]';
const ROWS = 'tr, [role="option"], li';

function controls(group: Element): HTMLElement[] {
  return [...group.querySelectorAll<HTMLElement>(CONTROLS)].filter(
    (e) => !e.closest('form') && e.closest(GROUPS) === group && !e.closest('[data-own-stops]'),
  );
}

/**
 * Put exactly one control of the group into the tab order: the last focused control, otherwise the control of the
 * current row, otherwise the first control.
 */
function settle(group: Element): void {
  const all = controls(group);
  const tabStop =
    all.find((e) => e === document.activeElement) ??
    all.find((e) => e.dataset['stop'] === 'yes') ??
    all.find((e) => e.getAttribute('aria-selected') === 'true' || e.closest('.current')) ??
    all[0];
  for (const e of all) mark(e, e === tabStop);
}

function mark(e: HTMLElement, stop: boolean): void {
  const tabindex = stop ? '0' : '-1';
  if (e.getAttribute('tabindex') !== tabindex) e.setAttribute('tabindex', tabindex);
  if (stop) e.dataset['stop'] = 'yes';
  else delete e.dataset['stop'];
}

/**
 * Return the control to which a key moves: the same column of the row above or below, the neighbour in the row, or the
 * same column of the first or last row.
 */
export function target(key: string, all: readonly HTMLElement[], from: HTMLElement): HTMLElement | null {
  const rows: HTMLElement[][] = [];
  let last: Element | null | undefined;
  for (const e of all) {
    const row = e.closest(ROWS);
    if (row === null || row !== last) rows.push([]);
    rows.at(-1)?.push(e);
    last = row;
  }
  const r = rows.findIndex((row) => row.includes(from));
  const c = rows[r]?.indexOf(from) ?? 0;
  const to = { ArrowDown: r + 1, ArrowUp: r - 1, PageDown: r + 10, PageUp: r - 10, Home: 0, End: rows.length - 1 }[key];
  if (to !== undefined) {
    const row = rows[Math.max(0, Math.min(rows.length - 1, to))];
    return row?.[Math.min(c, row.length - 1)] ?? null;
  }
  return (key === 'ArrowRight' ? rows[r]?.[c + 1] : key === 'ArrowLeft' ? rows[r]?.[c - 1] : undefined) ?? null;
}

/** Make a scrollable box without focusable content a tab stop, so that it can be scrolled by keyboard. */
function updateScrollStop(box: HTMLElement): void {
  const needsStop =
    (box.scrollHeight > box.clientHeight + 1 || box.scrollWidth > box.clientWidth + 1) &&
    !box.querySelector('a[href], button, input, select, textarea, [tabindex]');
  if (needsStop && !box.hasAttribute('tabindex')) {
    box.tabIndex = 0;
    box.dataset['scrolls'] = 'yes';
  } else if (!needsStop && box.dataset['scrolls']) {
    box.removeAttribute('tabindex');
    delete box.dataset['scrolls'];
  }
}

export function arrows(root: HTMLElement): () => void {
  let waiting = 0;
  const update = (): void => {
    waiting = 0;
    for (const group of root.querySelectorAll(GROUPS)) settle(group);
    for (const box of root.querySelectorAll<HTMLElement>('.scroll')) updateScrollStop(box);
  };
  const later = (): void => {
    waiting ||= requestAnimationFrame(update);
  };
  const watcher = new MutationObserver(later);
  watcher.observe(root, { childList: true, subtree: true });
  const onKey = (e: KeyboardEvent): void => {
    const from = e.target;
    if (!(from instanceof HTMLElement) || e.ctrlKey || e.metaKey || e.altKey || e.shiftKey || e.defaultPrevented)
      return;
    const group = from.closest(GROUPS);
    if (!group) return;
    const all = controls(group);
    if (!all.includes(from)) return;
    const to = target(e.key, all, from);
    if (!to) return;
    e.preventDefault();
    to.focus();
  };
  const onFocus = (e: FocusEvent): void => {
    const to = e.target;
    const group = to instanceof HTMLElement ? to.closest(GROUPS) : null;
    if (!group || !(to instanceof HTMLElement)) return;
    const all = controls(group);
    if (all.includes(to)) for (const c of all) mark(c, c === to);
  };
  root.addEventListener('keydown', onKey);
  root.addEventListener('focusin', onFocus);
  addEventListener('resize', later);
  later();
  return () => {
    watcher.disconnect();
    cancelAnimationFrame(waiting);
    root.removeEventListener('keydown', onKey);
    root.removeEventListener('focusin', onFocus);
    removeEventListener('resize', later);
  };
}

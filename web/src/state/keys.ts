/** Keyboard: page keys, letters after g, ABORT. Each page adds its own keys. */
import { PAGES, type Page } from '../lib/pages';
import { focusOf, spaceUse } from '../lib/spacekey';
import { abort } from './abort.svelte';
import { go } from './router.svelte';
import { view } from './view.svelte';

export { PAGES, type Page };

/** Prevent the focused element from receiving a key. */
function claim(e: KeyboardEvent): void {
  e.preventDefault();
  e.stopPropagation();
}

/**
 * Handle a key while the Rerun viewer has the focus. The viewer receives all keys except r, which closes it, and Esc,
 * which returns the keyboard to the page.
 */
function viewerKey(e: KeyboardEvent): void {
  if (e.ctrlKey || e.metaKey || e.altKey || typing(e.target)) return;
  if (e.key === 'Escape') {
    claim(e);
    (e.target as HTMLElement).blur();
  } else if (e.key === 'r') {
    claim(e);
    view.allKeys.find((k) => k.key === 'r')?.run();
  }
}

/** Page keys that repeat while they are held: older and newer. Another key could act on an item that was not seen. */
const REPEATED = ['[', ']'];
/** A key after `g` opens a page only within this time. */
const GO_WITHIN_MS = 2000;
let pendingGo = false;
let claimedSpace = false;

function typing(target: EventTarget | null): boolean {
  return (
    target instanceof HTMLElement &&
    (target.isContentEditable || ['INPUT', 'SELECT', 'TEXTAREA'].includes(target.tagName))
  );
}

/**
 * Handle a key in the capture phase, because the Rerun canvas consumes every key that it receives and ABORT must come
 * first.
 */
export function onKey(e: KeyboardEvent): void {
  if (e.key === 'Escape' && e.shiftKey) {
    claim(e);
    if (!e.repeat) abort.send();
    return;
  }
  if ((e.ctrlKey || e.metaKey) && !e.altKey && !e.shiftKey && e.key.toLowerCase() === 'k') {
    claim(e);
    if (view.opened === 'palette') view.close();
    else view.open('palette');
    return;
  }
  // Enter opens a confirmation, which receives the focus while the key is still held.
  if (e.key === 'Enter' && e.repeat && e.target instanceof Element && e.target.closest('[data-sends], input'))
    return claim(e);
  if (e.target instanceof Element && e.target.closest('[data-guest-keys]')) return viewerKey(e);
  if (e.ctrlKey || e.metaKey || e.altKey || typing(e.target)) return;
  if (e.key === ' ') {
    pendingGo = false;
    return space(e);
  }
  if (pendingGo) {
    pendingGo = false;
    const page = PAGES.find((p) => p.letter === e.key);
    if (page) {
      claim(e);
      go(page.path);
    }
    return;
  }
  if (handled(e)) e.preventDefault();
}

/**
 * Handle Space by the rules of lib/spacekey.ts. The event is consumed, because some browsers press the focused button
 * on key up and repeat the press on key down.
 */
function space(e: KeyboardEvent): void {
  const pageKey = view.allKeys.find((k) => k.key === ' ');
  const use = spaceUse(focusOf(e.target), pageKey !== undefined, view.opened !== 'none');
  claimedSpace = use !== 'native';
  if (!claimedSpace) return;
  claim(e);
  if (use === 'page' && !e.repeat) pageKey?.run();
}

export function onKeyUp(e: KeyboardEvent): void {
  if (e.key !== ' ' || !claimedSpace) return;
  claimedSpace = false;
  e.preventDefault();
}

function handled(e: KeyboardEvent): boolean {
  const pageKey = view.allKeys.find((k) => k.key === e.key);
  if (pageKey) {
    if (!e.repeat || REPEATED.includes(e.key)) pageKey.run();
    return true;
  }
  const page = PAGES[Number(e.key) - 1];
  if (/^[1-9]$/.test(e.key) && page) {
    go(page.path);
    return true;
  }
  switch (e.key) {
    case 'g':
      pendingGo = true;
      setTimeout(() => (pendingGo = false), GO_WITHIN_MS);
      return true;
    case '?':
      if (view.opened === 'keys') view.close();
      else view.open('keys');
      return true;
    case ':':
      view.open('line');
      return true;
    case 'Escape':
      if (view.opened !== 'none') view.close();
      return true;
    case 'o':
      view.overlaysOff = !view.overlaysOff;
      return true;
    case '/': {
      const box = document.querySelector<HTMLInputElement>('[data-search]');
      box?.focus();
      return box !== null;
    }
  }
  return false;
}

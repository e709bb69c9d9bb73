/** Keyboard: pages, go-to letters, ABORT; each page adds its keys. */
import { PAGES, type Page } from '../lib/pages';
import { focusOf, spaceUse } from '../lib/spacekey';
import { abort } from './abort.svelte';
import { go } from './router.svelte';
import { view } from './view.svelte';

export { PAGES, type Page };

/** Keeps a key from the focused element. */
function claim(e: KeyboardEvent): void {
  e.preventDefault();
  e.stopPropagation();
}

/**
 * The Rerun viewer has the focus: it keeps its keys, except r (shows and closes it) and Esc (gives the keyboard back).
 */
function guest(e: KeyboardEvent): void {
  if (e.ctrlKey || e.metaKey || e.altKey || typing(e.target)) return;
  if (e.key === 'Escape') {
    claim(e);
    (e.target as HTMLElement).blur();
  } else if (e.key === 'r') {
    claim(e);
    view.allKeys.find((k) => k.key === 'r')?.run();
  }
}

let pendingGo = false;
let claimedSpace = false;

function typing(target: EventTarget | null): boolean {
  return (
    target instanceof HTMLElement &&
    (target.isContentEditable || ['INPUT', 'SELECT', 'TEXTAREA'].includes(target.tagName))
  );
}

/** Listens in the capture phase: the Rerun canvas consumes every key it receives, and ABORT must come first. */
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
  if (e.target instanceof Element && e.target.closest('[data-guest-keys]')) return guest(e);
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
 * The rule is in lib/spacekey.ts. Space is consumed, because some browsers press the focused button on key up and
 * repeat it on key down.
 */
function space(e: KeyboardEvent): void {
  const own = view.allKeys.find((k) => k.key === ' ');
  const use = spaceUse(focusOf(e.target), own !== undefined, view.opened !== 'none');
  claimedSpace = use !== 'native';
  if (!claimedSpace) return;
  claim(e);
  if (use === 'page' && !e.repeat) own?.run();
}

export function onKeyUp(e: KeyboardEvent): void {
  if (e.key !== ' ' || !claimedSpace) return;
  claimedSpace = false;
  e.preventDefault();
}

function handled(e: KeyboardEvent): boolean {
  const own = view.allKeys.find((k) => k.key === e.key);
  if (own) {
    own.run();
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

/**
 * Controls that cannot be used now: dashed and inactive, but focusable, with the reason beside them on focus and
 * hover.
 */
import type { Attachment } from 'svelte/attachments';
import { session } from '../state/session.svelte';

type Control = HTMLButtonElement | HTMLInputElement | HTMLSelectElement | HTMLTextAreaElement;
const NOTE = 'held-reason';
const PASSED_KEYS = ['Tab', 'Escape', 'Shift'];
const SHOWS = ['focusin', 'pointerenter'] as const;
const HIDES = ['focusout', 'pointerleave'] as const;

function note(): HTMLElement {
  const there = document.getElementById(NOTE);
  if (there) return there;
  const made = document.createElement('div');
  made.id = NOTE;
  made.setAttribute('role', 'tooltip');
  made.hidden = true;
  return document.body.appendChild(made);
}

function show(target: Element, reason: string): void {
  const box = note();
  box.textContent = reason;
  box.hidden = false;
  const at = target.getBoundingClientRect();
  const below = at.bottom + 6 + box.offsetHeight < innerHeight;
  box.style.top = `${below ? at.bottom + 4 : at.top - box.offsetHeight - 4}px`;
  box.style.left = `${Math.max(4, Math.min(at.left, innerWidth - box.offsetWidth - 4))}px`;
}

function hide(): void {
  note().hidden = true;
}

/**
 * While held, `disabled` is only remembered: a disabled control takes no focus, so its reason would be unreachable by
 * keyboard.
 */
function shadowDisabled(control: Control): () => void {
  let wanted = control.disabled;
  control.disabled = false;
  Object.defineProperty(control, 'disabled', {
    configurable: true,
    get: () => wanted,
    set: (v: boolean) => (wanted = v),
  });
  return () => {
    delete (control as { disabled?: boolean }).disabled;
    control.disabled = wanted;
  };
}

function stops(element: HTMLElement): readonly string[] {
  if (element instanceof HTMLFormElement) return ['submit', 'drop'];
  return element instanceof HTMLButtonElement || element instanceof HTMLAnchorElement
    ? ['click']
    : ['click', 'mousedown', 'keydown', 'change', 'input', 'drop'];
}

/** Holds a button, field, link or form while `reason` is not empty: `<button {@attach held(reason)}>`. */
export function held(reason: string): Attachment<HTMLElement> {
  return (element) => {
    if (!reason) return;
    const stop = (e: Event): void => {
      if (e instanceof KeyboardEvent && PASSED_KEYS.includes(e.key)) return;
      e.preventDefault();
      e.stopImmediatePropagation();
      if (e.type !== 'keydown') show(element, reason);
    };
    const enter = (): void => show(element, reason);
    const before = {
      'aria-disabled': element.getAttribute('aria-disabled'),
      'aria-describedby': element.getAttribute('aria-describedby'),
      title: element.getAttribute('title'),
      'data-held': null,
    };
    const release = 'disabled' in element ? shadowDisabled(element as Control) : (): void => undefined;
    note();
    element.setAttribute('aria-disabled', 'true');
    element.setAttribute('aria-describedby', NOTE);
    element.setAttribute('data-held', reason);
    element.removeAttribute('title');
    for (const kind of stops(element)) element.addEventListener(kind, stop, { capture: true });
    for (const kind of SHOWS) element.addEventListener(kind, enter);
    for (const kind of HIDES) element.addEventListener(kind, hide);
    return () => {
      hide();
      release();
      for (const kind of stops(element)) element.removeEventListener(kind, stop, { capture: true });
      for (const kind of SHOWS) element.removeEventListener(kind, enter);
      for (const kind of HIDES) element.removeEventListener(kind, hide);
      for (const [name, value] of Object.entries(before))
        if (value === null) element.removeAttribute(name);
        else element.setAttribute(name, value);
    };
  };
}

/** Holds a control that the user's role may not use: `<button {@attach needs('catalogues.build')}>`. */
export function needs(permission: string): Attachment<HTMLElement> {
  return (element) => held(session.lacks(permission))(element);
}

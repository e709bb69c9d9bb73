/** Disabled controls with a reason: dashed and inactive, but focusable; the reason appears on focus and hover. */
import type { Attachment } from 'svelte/attachments';
import { session } from '../state/session.svelte';

type Control = HTMLButtonElement | HTMLInputElement | HTMLSelectElement | HTMLTextAreaElement;
const TOOLTIP_ID = 'disabled-reason';
const ALLOWED_KEYS = ['Tab', 'Escape', 'Shift'];
const SHOW_EVENTS = ['focusin', 'pointerenter'] as const;
const HIDE_EVENTS = ['focusout', 'pointerleave'] as const;

function tooltip(): HTMLElement {
  const existing = document.getElementById(TOOLTIP_ID);
  if (existing) return existing;
  const element = document.createElement('div');
  element.id = TOOLTIP_ID;
  element.setAttribute('role', 'tooltip');
  element.hidden = true;
  return document.body.appendChild(element);
}

function show(target: Element, reason: string): void {
  const box = tooltip();
  box.textContent = reason;
  box.hidden = false;
  const at = target.getBoundingClientRect();
  const below = at.bottom + 6 + box.offsetHeight < innerHeight;
  box.style.top = `${below ? at.bottom + 4 : at.top - box.offsetHeight - 4}px`;
  box.style.left = `${Math.max(4, Math.min(at.left, innerWidth - box.offsetWidth - 4))}px`;
}

function hide(): void {
  tooltip().hidden = true;
}

/**
 * Store assignments to `disabled` without applying them, and return a function that applies the last one. A control
 * with the attribute `disabled` cannot receive the focus. A user without a mouse could then not read the reason.
 */
function shadowDisabled(control: Control): () => void {
  let stored = control.disabled;
  control.disabled = false;
  Object.defineProperty(control, 'disabled', {
    configurable: true,
    get: () => stored,
    set: (v: boolean) => (stored = v),
  });
  return () => {
    delete (control as { disabled?: boolean }).disabled;
    control.disabled = stored;
  };
}

function blockedEvents(element: HTMLElement): readonly string[] {
  if (element instanceof HTMLFormElement) return ['submit', 'drop'];
  return element instanceof HTMLButtonElement || element instanceof HTMLAnchorElement
    ? ['click']
    : ['click', 'mousedown', 'keydown', 'change', 'input', 'drop'];
}

/** Disable a button, field, link or form while `reason` is not empty: `<button {@attach disabledBecause(reason)}>`. */
export function disabledBecause(reason: string): Attachment<HTMLElement> {
  return (element) => {
    if (!reason) return;
    const stop = (e: Event): void => {
      if (e instanceof KeyboardEvent && ALLOWED_KEYS.includes(e.key)) return;
      e.preventDefault();
      e.stopImmediatePropagation();
      if (e.type !== 'keydown') show(element, reason);
    };
    const enter = (): void => show(element, reason);
    const before = {
      'aria-disabled': element.getAttribute('aria-disabled'),
      'aria-describedby': element.getAttribute('aria-describedby'),
      title: element.getAttribute('title'),
      'data-disabled-reason': null,
    };
    const release = 'disabled' in element ? shadowDisabled(element as Control) : (): void => undefined;
    tooltip();
    element.setAttribute('aria-disabled', 'true');
    element.setAttribute('aria-describedby', TOOLTIP_ID);
    element.setAttribute('data-disabled-reason', reason);
    element.removeAttribute('title');
    for (const kind of blockedEvents(element)) element.addEventListener(kind, stop, { capture: true });
    for (const kind of SHOW_EVENTS) element.addEventListener(kind, enter);
    for (const kind of HIDE_EVENTS) element.addEventListener(kind, hide);
    return () => {
      hide();
      release();
      for (const kind of blockedEvents(element)) element.removeEventListener(kind, stop, { capture: true });
      for (const kind of SHOW_EVENTS) element.removeEventListener(kind, enter);
      for (const kind of HIDE_EVENTS) element.removeEventListener(kind, hide);
      for (const [name, value] of Object.entries(before))
        if (value === null) element.removeAttribute(name);
        else element.setAttribute(name, value);
    };
  };
}

/** Disable a control that the user's role may not use: `<button {@attach needsPermission('catalogues.build')}>`. */
export function needsPermission(permission: string): Attachment<HTMLElement> {
  return (element) => disabledBecause(session.permissionProblem(permission))(element);
}

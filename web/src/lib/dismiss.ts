/** Close a popover on Esc, wherever the focus is, and on a press outside it: `<div {@attach dismiss(close)}>`. */
import type { Attachment } from 'svelte/attachments';

/** `opener`: selector of the button that opens and closes the popover; presses on that button are not handled here. */
export function dismiss(close: () => void, opener = ''): Attachment<HTMLElement> {
  return (element) => {
    const onKey = (e: KeyboardEvent): void => {
      if (e.key !== 'Escape' || e.shiftKey) return;
      e.preventDefault();
      e.stopPropagation();
      close();
      if (opener) document.querySelector<HTMLElement>(opener)?.focus();
    };
    const onPress = (e: Event): void => {
      if (!(e.target instanceof Element) || element.contains(e.target)) return;
      if (opener && e.target.closest(opener)) return;
      close();
    };
    window.addEventListener('keydown', onKey, { capture: true });
    window.addEventListener('pointerdown', onPress, { capture: true });
    return () => {
      window.removeEventListener('keydown', onKey, { capture: true });
      window.removeEventListener('pointerdown', onPress, { capture: true });
    };
  };
}

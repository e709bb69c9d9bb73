/**
 * The effect of the space bar. One rule for all pages:
 * 1. A page that assigns a function to Space (Live: freeze or follow) receives it, whichever button has the focus.
 * 2. Elsewhere Space never presses a button that sends something to the sensor (`data-sends`); Enter does.
 * 3. Every other control keeps its use of Space, as do text fields, check boxes, list options and open panels.
 */
export type SpaceUse = 'page' | 'nothing' | 'native';
export interface Focus {
  /** A text field, check box, menu or list option, which uses Space. */
  takesSpace: boolean;
  /** A button that sends something to the sensor. */
  sends: boolean;
}

export function spaceUse(focus: Focus, pageUsesSpace: boolean, panelOpen: boolean): SpaceUse {
  if (focus.takesSpace) return 'native';
  if (focus.sends) return pageUsesSpace && !panelOpen ? 'page' : 'nothing';
  return pageUsesSpace && !panelOpen ? 'page' : 'native';
}

const OWN_SPACE =
  'input, select, textarea, summary, [contenteditable=true], ' +
  '[role=option], [role=menuitem], [role=checkbox], [role=switch]';

export function focusOf(target: EventTarget | null): Focus {
  if (!(target instanceof Element)) return { takesSpace: false, sends: false };
  return { takesSpace: target.closest(OWN_SPACE) !== null, sends: target.closest('[data-sends]') !== null };
}

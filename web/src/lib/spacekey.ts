/**
 * Effect of the space bar, the same on all pages:
 * 1. Text fields, check boxes, menus and list options always receive Space.
 * 2. If the page assigns a function to Space (Live: freeze or follow) and no panel is open, the page receives it.
 * 3. Otherwise Space never presses a button that sends something to the sensor (`data-sends`); Enter does.
 * 4. Otherwise Space has its normal effect.
 */
export type SpaceUse = 'page' | 'nothing' | 'native';
export interface Focus {
  /** True for a text field, check box, menu or list option, which uses Space. */
  takesSpace: boolean;
  /** True for a button that sends something to the sensor. */
  sends: boolean;
}

export function spaceUse(focus: Focus, pageUsesSpace: boolean, panelOpen: boolean): SpaceUse {
  if (focus.takesSpace) return 'native';
  if (focus.sends) return pageUsesSpace && !panelOpen ? 'page' : 'nothing';
  return pageUsesSpace && !panelOpen ? 'page' : 'native';
}

const USES_SPACE =
  'input, select, textarea, summary, [contenteditable=true], ' +
  '[role=option], [role=menuitem], [role=checkbox], [role=switch]';

export function focusOf(target: EventTarget | null): Focus {
  if (!(target instanceof Element)) return { takesSpace: false, sends: false };
  return { takesSpace: target.closest(USES_SPACE) !== null, sends: target.closest('[data-sends]') !== null };
}

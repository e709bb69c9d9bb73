/**
 * Where this console lives: at the root of a server of one unit, at /units/NAME for one of several. Changing the unit
 * reloads the page, so that nothing of another unit stays in memory.
 */
export function unitOf(path: string): string {
  return /^\/units\/([A-Za-z0-9][A-Za-z0-9_-]*)(?=\/|$)/.exec(path)?.[1] ?? '';
}

/** Name of the unit; empty at the root. */
export const unit = unitOf(globalThis.location?.pathname ?? '');
/** Begins every address of this console: pages and data. */
export const base = unit && `/units/${unit}`;

/** The path without the base; null for an address outside of this console. */
export function inside(path: string, of: string = base): string | null {
  if (path === of || path === `${of}/`) return '/';
  return path.startsWith(`${of}/`) && unitOf(path) === unitOf(`${of}/`) ? path.slice(of.length) : null;
}

/** Name in the browser's storage for what must not be mixed between units. */
export function ofUnit(name: string): string {
  return unit ? `${name} ${unit}` : name;
}

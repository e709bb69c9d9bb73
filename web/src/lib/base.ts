/**
 * Base path of this console: the root on a server with one unit, /units/NAME on a server with several units. Changing
 * the unit reloads the page, so that no data of another unit stays in memory.
 */
export function unitOf(path: string): string {
  return /^\/units\/([A-Za-z0-9][A-Za-z0-9_-]*)(?=\/|$)/.exec(path)?.[1] ?? '';
}

/** Name of the unit; empty at the root. */
export const unit = unitOf(globalThis.location?.pathname ?? '');
/** Prefix of all paths of this console, for pages and data. */
export const base = unit && `/units/${unit}`;

/** Return the path without the base; null if the path is outside this console. */
export function localPath(path: string, of: string = base): string | null {
  if (path === of || path === `${of}/`) return '/';
  return path.startsWith(`${of}/`) && unitOf(path) === unitOf(`${of}/`) ? path.slice(of.length) : null;
}

/** Return a key for the browser's storage that is separate for each unit. */
export function unitStorageKey(name: string): string {
  return unit ? `${name} ${unit}` : name;
}

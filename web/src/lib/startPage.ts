/** Page that opens after sign-in: chosen by the user, or the page of the role. */
import { ApiError } from '../api/http';
import type { SessionInfo, View } from '../api/types';
import { PAGES } from './pages';

export interface StartOption {
  path: string;
  text: string;
}
type Start = Pick<SessionInfo, 'start_page' | 'role_start_page' | 'permissions'>;

const pageOf = (path: string) => PAGES.find((p) => p.path === path.split('?')[0]);

/** Return the name of a page that is not in the list: "Frames with filters", "Star 27989". */
function nameOf(path: string): string {
  const page = pageOf(path);
  if (page) return `${page.name} with filters`;
  const [kind = '', id = ''] = path.replace(/\?.*/, '').split('/').filter(Boolean);
  return `${kind.charAt(0).toUpperCase()}${kind.slice(1).replace(/s$/, '')} ${id}`.trim();
}

/** Return the page to open. If the role may not see the chosen page, the page of the role opens. */
export function startPath(info: Start): string {
  const permission = pageOf(info.start_page ?? '')?.permission;
  const permitted = !permission || info.permissions?.includes(permission);
  return (permitted && info.start_page !== '/' && info.start_page) || info.role_start_page || '/live';
}

/**
 * Return the page to open instead of a view that could not be read: the page of the role, if the view is the start page
 * and has been deleted. Null otherwise.
 */
export function afterDeletedView(error: unknown, view: number | null, info: Start): string | null {
  const deleted = error instanceof ApiError && error.status === 404;
  return deleted && info.start_page === `/views/${view}` ? startPath({ ...info, start_page: '' }) : null;
}

/** Return the pages to choose from. The first one is the page of the role; a chosen page is always in the list. */
export function startOptions(info: Start, views: readonly View[]): StartOption[] {
  const ofRole = pageOf(info.role_start_page ?? '')?.name ?? 'Live';
  const options = [
    { path: '', text: `${ofRole} (page of your role)` },
    ...PAGES.filter((p) => !p.permission || info.permissions?.includes(p.permission)).map((p) => ({
      path: p.path,
      text: p.name,
    })),
    ...views.map((v) => ({ path: `/views/${v.id}`, text: `View: ${v.name}` })),
  ];
  const chosen = info.start_page ?? '';
  if (!options.some((o) => o.path === chosen)) options.push({ path: chosen, text: nameOf(chosen) });
  return options;
}

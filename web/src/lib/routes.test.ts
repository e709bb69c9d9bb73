import { describe, expect, it } from 'vitest';
import { PAGES } from './pages';
import { hasPage, matchRoute } from './routes';

describe('addresses', () => {
  it('lead a number to one item and the name alone to the list', () => {
    expect(matchRoute('/frames')?.page).toBe('frames');
    expect(matchRoute('/frames/12')).toEqual({ page: 'frame', props: { id: 12 } });
    expect(matchRoute('/catalogues/new')?.props).toEqual({ id: null });
    expect(matchRoute('/catalogues/7/')?.props).toEqual({ id: 7 });
  });
  it('lead to no page otherwise', () => {
    for (const path of ['/', '/frames/x', '/frames/1/2', '/nowhere', '/frames/-1']) expect(matchRoute(path)).toBeNull();
  });
  it('have a folder for every page of the sidebar', () => {
    for (const p of PAGES) expect(hasPage(matchRoute(p.path)?.page ?? '')).toBe(true);
  });
});

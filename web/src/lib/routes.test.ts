import { describe, expect, it } from 'vitest';
import { PAGES } from './pages';
import { hasPage, matchRoute } from './routes';

describe('addresses', () => {
  it('leads a number to one thing and the bare name to the list', () => {
    expect(matchRoute('/frames')?.file).toBe('Frames');
    expect(matchRoute('/frames/12')).toEqual({ file: 'FrameDetail', props: { id: 12 } });
    expect(matchRoute('/catalogues/new')?.props).toEqual({ id: null });
    expect(matchRoute('/catalogues/7/')?.props).toEqual({ id: 7 });
  });
  it('knows no page for anything else', () => {
    for (const path of ['/', '/frames/x', '/frames/1/2', '/nowhere', '/frames/-1']) expect(matchRoute(path)).toBeNull();
  });
  it('has a file for every page of the rail', () => {
    for (const p of PAGES) expect(hasPage(matchRoute(p.path)?.file ?? '')).toBe(true);
  });
});

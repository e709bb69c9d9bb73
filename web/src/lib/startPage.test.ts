import { describe, expect, it } from 'vitest';
import { ApiError } from '../api/http';
import type { View } from '../api/types';
import { afterDeletedView, startOptions, startPath } from './startPage';

const info = (start_page: string, permissions = ['view']) => ({ start_page, role_start_page: '/frames', permissions });
const view = { id: 4, name: 'Night', path: '/telemetry?plot=a.b' } as View;

describe('the start page', () => {
  it('is the page of the role unless the user has chosen another', () => {
    expect(startPath(info(''))).toBe('/frames');
    expect(startPath(info('/telemetry?plot=a.b'))).toBe('/telemetry?plot=a.b');
  });
  it('is the page of the role if the chosen page is no longer permitted', () => {
    expect(startPath(info('/admin?show=audit'))).toBe('/frames');
    expect(startPath(info('/admin?show=audit', ['admin.health']))).toBe('/admin?show=audit');
  });
  it('is chosen from permitted pages and shared views', () => {
    const options = startOptions(info(''), [view]);
    expect(options[0]).toEqual({ path: '', text: 'Frames (page of your role)' });
    expect(options.map((o) => o.path)).not.toContain('/admin');
    expect(options.at(-1)).toEqual({ path: '/views/4', text: 'View: Night' });
  });
  it('is the page of the role if it is a deleted view', () => {
    const failed = (status: number) => new ApiError(status, { id: '', message: '', expected: '', got: '', hint: '' });
    expect(afterDeletedView(failed(404), 4, info('/views/4'))).toBe('/frames');
    expect(afterDeletedView(failed(503), 4, info('/views/4'))).toBeNull();
    expect(afterDeletedView(failed(404), 4, info('/views/5'))).toBeNull();
  });
  it('stays in the list if it is a page with filters', () => {
    const options = startOptions(info('/telemetry?plot=a.b'), []);
    expect(options.at(-1)).toEqual({ path: '/telemetry?plot=a.b', text: 'Telemetry with filters' });
  });
});

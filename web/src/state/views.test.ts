import { expect, it } from 'vitest';
import type { View } from '../api/types';
import { keptPages, telemetryPath, telemetryViews } from './views.svelte';

const page = { name: 'power & heat', fields: ['housekeeping.mode', 'attitude.ra_deg'], plot: ['housekeeping.mode'] };
const view = (path: string): View => ({
  id: 1,
  name: 'a',
  path,
  note: '',
  owner: 'ann',
  open: false,
  version: 1,
  user: 'ann',
  changed: '2026-12-01T18:00:00.000Z',
});

it('finds the parameters of a telemetry page in the address of its view', () => {
  const path = telemetryPath(page);
  expect(new URL(path, 'http://a').searchParams.get('own')).toBe('power & heat');
  expect(telemetryViews([view('/frames?mode=x'), view('/telemetry?page=power'), view(path)])).toEqual([
    { view: view(path), fields: page.fields },
  ]);
});

it('reads pages that an earlier version kept in the browser, and leaves out what is not one', () => {
  expect(keptPages(JSON.stringify([page, { name: 3 }, null]))).toEqual([page]);
  expect(keptPages('{')).toEqual([]);
  expect(keptPages(null)).toEqual([]);
});

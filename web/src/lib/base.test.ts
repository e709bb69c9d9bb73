import { describe, expect, it } from 'vitest';
import { localPath, unitOf } from './base';

describe('paths of units', () => {
  it('returns the name of the unit in a path', () => {
    expect(unitOf('/units/FM1/live')).toBe('FM1');
    expect(unitOf('/units/EM-2')).toBe('EM-2');
    for (const path of ['/', '/live', '/units', '/units/', '/units//live', '/x/units/FM1/live'])
      expect(unitOf(path)).toBe('');
  });
  it('removes the base from a path of this console and returns null for any other path', () => {
    expect(localPath('/units/FM1/frames/3', '/units/FM1')).toBe('/frames/3');
    expect(localPath('/units/FM1', '/units/FM1')).toBe('/');
    expect(localPath('/units/FM12/live', '/units/FM1')).toBeNull();
    expect(localPath('/fleet', '/units/FM1')).toBeNull();
    expect(localPath('/live', '')).toBe('/live');
    expect(localPath('/units/FM1/live', '')).toBeNull();
  });
});

const SOURCES = import.meta.glob<string>(['../**/*.svelte', '../**/*.ts', '!../**/*.test.ts', '!../api/generated/**'], {
  query: '?raw',
  import: 'default',
  eager: true,
});
/** Links to pages that all units share. */
const SHARED_PAGES = /href="\/(help|fleet|units)/;

describe('links', () => {
  it('start with the base, so that they do not lead to another unit', () => {
    const rootRelative = /(href|src|action|url|save)="\/|EventSource\('\/|fetch\('\/|url: ['`]\/|location\.assign\('\//;
    const withoutBase = Object.entries(SOURCES).flatMap(([file, text]) =>
      text
        .split('\n')
        .flatMap((line, i) =>
          rootRelative.test(line) && !SHARED_PAGES.test(line) ? [`${file}:${i + 1}: ${line.trim()}`] : [],
        ),
    );
    expect(withoutBase).toEqual([]);
  });
});

import { describe, expect, it } from 'vitest';
import { localPath, unitOf } from './base';

describe('addresses of units', () => {
  it('names the unit of an address', () => {
    expect(unitOf('/units/FM1/live')).toBe('FM1');
    expect(unitOf('/units/EM-2')).toBe('EM-2');
    for (const path of ['/', '/live', '/units', '/units/', '/units//live', '/x/units/FM1/live'])
      expect(unitOf(path)).toBe('');
  });
  it('knows what is of this console', () => {
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
/** What all units share. */
const SHARED = /href="\/(help|fleet|units)/;

describe('links', () => {
  it('begin with the base, or they would lead to another unit', () => {
    const bare = /(href|src|action|url|save)="\/|EventSource\('\/|fetch\('\/|url: ['`]\/|location\.assign\('\//;
    const wrong = Object.entries(SOURCES).flatMap(([file, text]) =>
      text
        .split('\n')
        .flatMap((line, i) => (bare.test(line) && !SHARED.test(line) ? [`${file}:${i + 1}: ${line.trim()}`] : [])),
    );
    expect(wrong).toEqual([]);
  });
});

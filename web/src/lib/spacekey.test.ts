import { readdirSync, readFileSync } from 'node:fs';
import { join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { describe, expect, it } from 'vitest';
import { spaceUse } from './spacekey';

const BUTTON = { takesSpace: false, sends: false };
const SENDS = { takesSpace: false, sends: true };

describe('the space bar', () => {
  it('is reserved for a page that uses it and never presses the focused button there', () => {
    expect([spaceUse(BUTTON, true, false), spaceUse(SENDS, true, false)]).toEqual(['page', 'page']);
  });
  it('never presses a button that sends something to the sensor, on any page and beside any open panel', () => {
    for (const uses of [true, false])
      for (const open of [true, false]) expect(spaceUse(SENDS, uses, open)).not.toBe('native');
  });
  it('keeps its native use on ordinary controls if no page uses it', () => {
    expect([spaceUse(BUTTON, false, false), spaceUse(BUTTON, true, true)]).toEqual(['native', 'native']);
  });
  it('stays with fields, check boxes and options', () => {
    expect(spaceUse({ takesSpace: true, sends: false }, true, false)).toBe('native');
  });
});

/** Calls that make the server send something to the sensor. */
const SENDING = new RegExp(
  String.raw`sendCommand\(|abort\.send\(|requests\.(automatic|step)\(|api\.(abort|retry|addScheduled|cancelScheduled|` +
    String.raw`refreshSchedule|upload|uploadTable|uploadFrame|startDownload|transferAction)\(`,
);

describe('buttons that send', () => {
  const source = fileURLToPath(new URL('../', import.meta.url));
  const files = readdirSync(source, { recursive: true, encoding: 'utf8' }).filter((f) => f.endsWith('.svelte'));
  it('are marked if the call is written in the button', () => {
    const unmarked = files.flatMap((file) => {
      const text = readFileSync(join(source, file), 'utf8');
      return [...text.matchAll(/<button\b(?:[^>{]|\{(?:[^{}]|\{[^{}]*\})*\})*>/g)]
        .map((m) => m[0])
        .filter((tag) => SENDING.test(tag) && !tag.includes('data-sends'))
        .map((tag) => `${file}: ${tag.slice(0, 100)}`);
    });
    expect(unmarked).toEqual([]);
  });
  it('exist in every component that sends', () => {
    const missing = files.filter((file) => {
      const text = readFileSync(join(source, file), 'utf8');
      return SENDING.test(text) && !text.includes('data-sends') && !file.endsWith('CommandLine.svelte');
    });
    expect(missing).toEqual([]);
  });
});

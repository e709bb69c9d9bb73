import { describe, expect, it } from 'vitest';
import type { CatalogueDetail, Heads, Profile } from '../../api/types';
import { Builder } from './builder.svelte';
import { optional } from './fields';

const CAMERAS = [
  { name: 'cubestar', faint_mag: 3.8, unit: true, formats: ['cubestar'] },
  { name: 'sunsat', faint_mag: 5, unit: false, formats: ['sunsat'] },
] as unknown as Profile[];

describe('the builder', () => {
  it('starts with the camera of the unit and its limit', () => {
    const b = new Builder();
    b.startWith([{ ...CAMERAS[1], unit: true } as Profile]);
    expect([b.profile, b.texts.faint_mag]).toEqual(['sunsat', '5']);
  });

  it('keeps a limit that was typed before the list of cameras came', () => {
    const b = new Builder();
    b.texts.faint_mag = '4';
    b.startWith(CAMERAS);
    expect([b.profile, b.texts.faint_mag, b.first.faint_mag]).toEqual(['cubestar', '4', '3.8']);
  });

  it('keeps a camera that was selected before', () => {
    const b = new Builder();
    b.pick(CAMERAS[1] as Profile);
    b.startWith(CAMERAS);
    expect([b.profile, b.texts.faint_mag]).toEqual(['sunsat', '5']);
  });

  it('starts a new catalogue without the request of the one that was open', () => {
    const b = new Builder();
    b.startWith(CAMERAS);
    const fresh = JSON.stringify(b.request);
    const request = { faint_mag: 6.5, days: 30, source: 'list', star_list: 3, orbit: 'tle', tle: 'x' };
    b.fill({ name: 'seven', profile: 'sunsat', format: 'sunsat', request });
    expect(JSON.stringify(b.request)).not.toBe(fresh);
    b.reset();
    expect(JSON.stringify(b.request)).toBe(fresh);
  });

  it('does not load a preview while a field is invalid', () => {
    const b = new Builder();
    b.busy = true;
    b.texts.days = '1,5';
    b.changed();
    expect([b.valid, b.busy]).toEqual([false, false]);
  });

  it('knows an optional field that is not a number', () => {
    expect(['', ' ', '1991.25', '\u22121', '1991,25'].map(optional)).toEqual([null, null, 1991.25, -1, NaN]);
  });

  it('sends a circular orbit by default, and the shape of an eccentric one', () => {
    const b = new Builder();
    b.startWith(CAMERAS);
    b.orbit = 'elements';
    expect([b.request.eccentricity, b.request.perigee_deg]).toEqual([0, 0]);
    Object.assign(b.texts, { altitude_km: '20188', eccentricity: '0.74', perigee_deg: '270' });
    expect(b.valid).toBe(true);
    const again = new Builder();
    again.fill({
      name: 'molniya',
      profile: 'cubestar',
      format: 'cubestar',
      request: b.request,
    } as unknown as CatalogueDetail);
    expect([again.request.eccentricity, again.request.perigee_deg]).toEqual([0.74, 270]);
    again.texts.eccentricity = '1.2';
    expect(again.valid).toBe(false);
    again.orbit = 'tle';
    expect(again.request.eccentricity).toBe(0);
  });

  it('sends the mountings of all heads of a spacecraft, and keeps them when a catalogue is loaded again', () => {
    const b = new Builder();
    b.startWith(CAMERAS);
    b.mountedBy = 'heads';
    expect(b.valid).toBe(false);
    b.mount({
      heads: [
        { unit: 'A', mounting_deg: [0, 0, 0] },
        { unit: 'B', mounting_deg: [70, 20, 0] },
      ],
    } as unknown as Heads);
    expect(b.valid).toBe(true);
    const again = new Builder();
    again.fill({
      name: 'two',
      profile: 'cubestar',
      format: 'cubestar',
      request: b.request,
    } as unknown as CatalogueDetail);
    expect(again.request.heads?.map((h) => [h.unit, h.mounting_deg])).toEqual([
      ['A', [0, 0, 0]],
      ['B', [70, 20, 0]],
    ]);
    again.mountedBy = 'law';
    expect(again.request.heads).toEqual([]);
  });
});

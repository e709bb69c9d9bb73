import { describe, expect, it } from 'vitest';
import type { Profile } from '../../api/types';
import { Builder } from './builder.svelte';

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
});

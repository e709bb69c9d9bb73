/** Text fields of the catalogue builder, with their ranges and defaults. */

export interface Texts {
  inclination_deg: string;
  raan_from: string;
  raan_to: string;
  altitude_km: string;
  eccentricity: string;
  perigee_deg: string;
  days: string;
  roll: string;
  pitch: string;
  yaw: string;
  ra_deg: string;
  dec_deg: string;
  field_roll_deg: string;
  off_nadir_deg: string;
  margin_deg: string;
  faint_mag: string;
  bright_mag: string;
  min_separation_deg: string;
  brightest_per_field: string;
  earth_margin_deg: string;
  sun_deg: string;
  moon_deg: string;
  pair_min_deg: string;
  pair_max_deg: string;
  epoch_jyear: string;
  companions: string;
  false_triples: string;
  ring_arc: string;
  ring_tolerance: string;
  reduced_width: string;
  reduced_height: string;
  reduced_brightest: string;
  reduced_step: string;
  turn_x: string;
  turn_y: string;
  turn_z: string;
}
export const LIMITS: Record<keyof Texts, [number, number]> = {
  inclination_deg: [0, 180],
  raan_from: [-360, 720],
  raan_to: [-360, 720],
  altitude_km: [100, 1_000_000],
  eccentricity: [0, 0.99],
  perigee_deg: [-360, 360],
  days: [0.1, 3660],
  roll: [0, 180],
  pitch: [0, 180],
  yaw: [0, 180],
  ra_deg: [0, 360],
  dec_deg: [-90, 90],
  field_roll_deg: [-360, 360],
  off_nadir_deg: [0, 80],
  margin_deg: [0, 20],
  faint_mag: [-2, 21],
  bright_mag: [-3, 21],
  min_separation_deg: [0, 5],
  brightest_per_field: [0, 500],
  earth_margin_deg: [0, 60],
  sun_deg: [1, 179],
  moon_deg: [1, 179],
  pair_min_deg: [0, 20],
  pair_max_deg: [0.1, 120],
  epoch_jyear: [1800, 2200],
  companions: [0, 100_000],
  false_triples: [0, 1_000_000],
  ring_arc: [0.1, 179],
  ring_tolerance: [0.0001, 10],
  reduced_width: [1, 120],
  reduced_height: [1, 120],
  reduced_brightest: [1, 100],
  reduced_step: [0.25, 10],
  turn_x: [-360, 360],
  turn_y: [-360, 360],
  turn_z: [-360, 360],
};
export const OPTIONAL: readonly (keyof Texts)[] = [
  'pair_max_deg',
  'altitude_km',
  'sun_deg',
  'moon_deg',
  'epoch_jyear',
  'companions',
  'false_triples',
];
export const START: Texts = {
  inclination_deg: '97.6',
  raan_from: '0',
  raan_to: '360',
  altitude_km: '',
  eccentricity: '0',
  perigee_deg: '0',
  days: '14',
  roll: '5',
  pitch: '5',
  yaw: '5',
  ra_deg: '0',
  dec_deg: '0',
  field_roll_deg: '0',
  off_nadir_deg: '30',
  margin_deg: '0.5',
  faint_mag: '3.8',
  bright_mag: '-2',
  min_separation_deg: '0',
  brightest_per_field: '0',
  earth_margin_deg: '0',
  sun_deg: '',
  moon_deg: '',
  pair_min_deg: '0.25',
  pair_max_deg: '',
  epoch_jyear: '',
  companions: '',
  false_triples: '',
  ring_arc: '8',
  ring_tolerance: '0.01',
  reduced_width: '36',
  reduced_height: '36',
  reduced_brightest: '8',
  reduced_step: '1',
  turn_x: '0',
  turn_y: '0',
  turn_z: '0',
};

export function wholeOr(text: string): number | null {
  return text.trim() ? Math.round(number(text)) : null;
}

/** Parse an optional number: null if the text is empty, NaN if it is not a number. */
export function optional(text: string): number | null {
  return text.trim() ? number(text) : null;
}

export function number(text: string): number {
  return text.trim() === '' ? NaN : Number(text.replace('\u2212', '-'));
}

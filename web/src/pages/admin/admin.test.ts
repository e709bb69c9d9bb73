import { expect, it } from 'vitest';
import { confirmationOf } from './admin';

it('confirms exactly what the preview showed, as of its time', () => {
  const counts = { at: '2026-12-01T18:00:00.000Z', frames: 3, frames_bytes: 1500, packets: 200, to_thin: 7, events: 9 };
  expect(confirmationOf({ ...counts, unusual: '3 of 4 frames with pixels (75 %)' })).toEqual(counts);
});

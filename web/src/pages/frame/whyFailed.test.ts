import { describe, expect, it } from 'vitest';
import { elongation, explain, fieldWords, mainRejection } from './whyFailed';

type Run = Parameters<typeof explain>[0];
const region = (width: number, height: number, rejected = ''): Run['regions'][number] => ({
  col_min: 10,
  row_min: 10,
  col_max: 9 + width,
  row_max: 9 + height,
  area_px: width * height,
  peak_dn: 100,
  rejected,
});
const run = (over: Partial<Run>): Run => ({
  chain: 'cubestar',
  reason: 'no match',
  cause: '',
  found: 20,
  matched: 0,
  regions: Array.from({ length: 20 }, () => region(4, 4)),
  stars: [],
  camera_name: 'cubestar',
  ...over,
});
const frame = { profile: 'cubestar', complete: true };
const causeOf = (over: Partial<Run>): [string, string | undefined] => {
  const e = explain(run(over), frame);
  return [e.cause.split(':')[0] ?? '', e.remedy?.label];
};

describe('the likely cause of a run without a solution', () => {
  it.each<[string, Partial<Run>, string, string | undefined]>([
    ['mirrored', { cause: 'mirrored' }, 'mirrored', undefined],
    ['scale', { cause: 'scale' }, 'scale of the image differs', 'Solve without a camera'],
    [
      'trails',
      { regions: Array.from({ length: 8 }, () => region(20, 2)), found: 8 },
      'trails',
      'Run the reference chain',
    ],
    [
      'hot pixels',
      { regions: Array.from({ length: 60 }, () => region(1, 1)), found: 60 },
      'one or two pixels',
      'Run the reference chain',
    ],
    [
      'rejected',
      { found: 1, regions: Array.from({ length: 9 }, () => region(9, 9, 'area 81 px > max 60')) },
      'rejected',
      'Run the reference chain',
    ],
    ['few stars', { found: 2, regions: [region(3, 3), region(3, 3)] }, 'Too few stars', 'Run the reference chain'],
    ['wrong camera', {}, 'Enough stars', 'Solve without a camera'],
  ])('%s', (_, over, words, label) => {
    const e = explain(run(over), frame);
    expect(e.cause).toContain(words);
    expect(e.remedy?.label).toBe(label);
  });
  it('offers no run that has just failed', () => {
    expect(causeOf({ chain: 'reference', camera_name: 'blind', found: 40 })[1]).toBeUndefined();
  });
});

describe('the stages', () => {
  it('state their numbers, and the reason as it was reported', () => {
    const { stages } = explain(run({ found: 1, regions: [region(4, 4), region(9, 9, 'area 81 px > max 60')] }), frame);
    expect(stages.map((s) => [s.name, s.passed])).toEqual([
      ['Detection', true],
      ['Stars', false],
      ['Identification', null],
      ['Verification', null],
    ]);
    expect(stages[1]?.words).toBe('1 usable, 1 rejected, most: area (1): no match');
    expect(stages[3]?.words).toBe('not reached');
  });
  it('name the most frequent rejection', () => {
    const list = [region(1, 1, 'area 1 px < min 6'), region(1, 1, 'area 2 px < min 6'), region(2, 2, 'saturated')];
    expect(mainRejection(list)).toEqual({ words: 'area', count: 2 });
    expect(mainRejection([region(1, 1)])).toBeNull();
  });
});

it('describes shape, field and scale', () => {
  expect(elongation(region(12, 3))).toBe(4);
  expect(fieldWords({ fov_deg: null })).toBe('');
  expect(fieldWords({ fov_deg: [14.52, 9.71] })).toBe('14.52° × 9.71°');
  const camera = {
    columns: 1024,
    rows: 512,
    focal_col_px: 4000,
    focal_row_px: 4000,
    centre_col_px: 512,
    centre_row_px: 256,
    distortion: {},
  };
  expect(fieldWords({ fov_deg: [14.52, 7.3], camera })).toBe('14.52° × 7.30°, 51.6″/px');
});

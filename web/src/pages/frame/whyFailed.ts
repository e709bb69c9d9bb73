/** Explanation of a run without a solution: stages with their numbers, the likely cause, and a run that may succeed. */
import type { FrameDetail, SolutionDetail } from '../../api/types';

/** A run that may succeed. */
export interface Remedy {
  label: string;
  chain: string;
  blind: boolean;
  profile: string | null;
}
export interface Stage {
  name: string;
  /** Null if the run ended before this stage. */
  passed: boolean | null;
  words: string;
}
export interface Explanation {
  stages: Stage[];
  cause: string;
  remedy: Remedy | null;
}
type Run = Pick<
  SolutionDetail,
  'chain' | 'reason' | 'cause' | 'found' | 'matched' | 'regions' | 'stars' | 'camera_name'
>;

/** Minimum number of stars for an attitude that can be verified. */
export const MIN_STARS = 4;
/** Number of stars from which a lack of stars is not the cause of a failure. */
const SUFFICIENT_STARS = 12;
const LONG = 3;
const HOT_SHARE = 0.6;

/** Return the most frequent reason for rejected regions, without its numbers. */
export function mainRejection(regions: Run['regions']): { words: string; count: number } | null {
  const counts = new Map<string, number>();
  for (const r of regions)
    if (r.rejected) {
      const words = r.rejected.replace(/[\d.,−-]+.*$/, '').trim() || r.rejected;
      counts.set(words, (counts.get(words) ?? 0) + 1);
    }
  const [first] = [...counts].sort((a, b) => b[1] - a[1]);
  return first ? { words: first[0], count: first[1] } : null;
}

/** Return the ratio of length to width of a region's box; about 1 for a round star. */
export function elongation(r: Run['regions'][number]): number {
  const [w, h] = [r.col_max - r.col_min + 1, r.row_max - r.row_min + 1];
  return Math.max(w, h) / Math.max(1, Math.min(w, h));
}

const median = (values: readonly number[]): number => [...values].sort((a, b) => a - b)[values.length >> 1] ?? 0;

export function explain(run: Run, frame: Pick<FrameDetail, 'profile' | 'complete'>): Explanation {
  const rejected = run.regions.filter((r) => r.rejected).length;
  const main = mainRejection(run.regions);
  const enough = run.found >= MIN_STARS;
  const stages: Stage[] = [
    {
      name: 'Detection',
      passed: run.regions.length > 0 || run.found > 0,
      words: run.regions.length ? `${run.regions.length} regions above the threshold` : `${run.found} stars`,
    },
    {
      name: 'Stars',
      passed: enough,
      words:
        `${run.found} usable` +
        (rejected ? `, ${rejected} rejected` + (main ? `, most: ${main.words} (${main.count})` : '') : ''),
    },
    {
      name: 'Identification',
      passed: run.matched >= MIN_STARS,
      words: `${run.matched} matched`,
    },
    { name: 'Verification', passed: false, words: 'no attitude was accepted' },
  ];
  const failed = stages.findIndex((s) => !s.passed);
  stages.forEach((s, i) => {
    if (i > failed) [s.passed, s.words] = [null, 'not reached'];
    else if (i === failed && run.reason) s.words += `: ${run.reason}`;
  });
  return { stages, ...causeOf(run, frame, rejected) };
}

function causeOf(
  run: Run,
  frame: Pick<FrameDetail, 'profile' | 'complete'>,
  rejected: number,
): Pick<Explanation, 'cause' | 'remedy'> {
  const reference: Remedy | null =
    run.chain === 'reference'
      ? null
      : { label: 'Run the reference chain', chain: 'reference', blind: false, profile: frame.profile };
  const blind: Remedy = { label: 'Solve without a camera', chain: 'reference', blind: true, profile: null };
  const isBlind = run.camera_name === 'blind';
  if (run.cause === 'mirrored')
    return { cause: 'The image is mirrored. Reverse the file from left to right and import it again.', remedy: null };
  if (run.cause === 'scale')
    return { cause: 'The scale of the image differs from that of the assumed camera.', remedy: isBlind ? null : blind };
  const boxes = run.regions.filter((r) => r.area_px >= 6);
  if (boxes.length >= MIN_STARS && median(boxes.map(elongation)) >= LONG)
    return {
      cause: 'The stars are trails: the camera rotated during the exposure. Shorten it, or use a chain for trails.',
      remedy: reference,
    };
  const tiny = run.regions.filter((r) => r.area_px <= 2).length;
  if (run.regions.length > 2 * SUFFICIENT_STARS && tiny > HOT_SHARE * run.regions.length)
    return {
      cause: 'Most regions are one or two pixels: hot pixels or noise. Raise the threshold, or use a dark frame.',
      remedy: reference,
    };
  if (run.found < MIN_STARS) {
    if (rejected > run.found)
      return {
        cause: 'Most regions were rejected because of clouds, stray light, or unsuitable area limits.',
        remedy: reference,
      };
    return {
      cause: 'Too few stars were detected because of clouds, a short exposure, or a high threshold.',
      remedy: reference,
    };
  }
  if (run.found >= SUFFICIENT_STARS && !isBlind)
    return {
      cause: 'Enough stars were detected. The assumed camera, and so the scale, is probably wrong.',
      remedy: blind,
    };
  return {
    cause: 'The stars do not match the catalogue because of false detections, or stars fainter than the catalogue.',
    remedy: reference ?? (isBlind ? null : blind),
  };
}

/** Format the field of view of a solution and its scale at the centre: "14.52° × 9.71°, 51.1″/px". */
export function fieldWords(s: Pick<SolutionDetail, 'fov_deg'> & Partial<Pick<SolutionDetail, 'camera'>>): string {
  if (!s.fov_deg) return '';
  const [w, h] = s.fov_deg;
  const scale = s.camera?.focal_col_px ? `, ${((3600 * 180) / Math.PI / s.camera.focal_col_px).toFixed(1)}″/px` : '';
  return `${w.toFixed(2)}° × ${h.toFixed(2)}°${scale}`;
}

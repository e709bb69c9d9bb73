import { base } from './base';
import { writeIds } from './idlist';

/** Which recording, as other pages name it, as the URL contains it, and as the server expects it. */
export type RerunOf =
  | { frames: readonly number[] }
  | { contact: number }
  | { calibration: number }
  | { analysis: number }
  | { campaign: number }
  | { live: true };
const KINDS = ['frames', 'contact', 'calibration', 'analysis', 'campaign'] as const;

export function rerunQuery(of: RerunOf): string {
  if ('live' in of) return 'live=1';
  const [kind, value] = Object.entries(of)[0] as [string, number | readonly number[]];
  return `${kind}=${typeof value === 'number' ? value : writeIds(value).replaceAll(' ', '')}`;
}

/** The recording that a URL requests: the server's URL of it and a description; null if it requests none. */
export function recordingOf(
  query: (name: string) => string,
): { url: string; live: boolean; words: string; back: string } | null {
  if (query('live')) return { url: `${base}/api/rerun/live`, live: true, words: 'live', back: '/live' };
  const kind = KINDS.find((k) => query(k));
  if (!kind) return null;
  const value = query(kind);
  const back = {
    frames: '/frames',
    contact: `/contacts/${value}`,
    calibration: `/calibration?id=${value}`,
    analysis: `/calibration?tab=analyses&id=${value}`,
    campaign: '/campaigns',
  }[kind];
  return {
    url: `${base}/api/rerun/recording.rrd?${new URLSearchParams({ [kind]: value }).toString()}`,
    live: false,
    words: `${kind === 'frames' ? 'frames' : kind} ${value}`,
    back,
  };
}

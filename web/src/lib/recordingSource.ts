import { base } from './base';
import { writeIds } from './idlist';

/** Source of a recording; the functions below convert it to the URL of the page and to the request to the server. */
export type RecordingSource =
  | { frames: readonly number[] }
  | { contact: number }
  | { calibration: number }
  | { analysis: number }
  | { campaign: number }
  | { live: true };
const KINDS = ['frames', 'contact', 'calibration', 'analysis', 'campaign'] as const;

export function rerunQuery(of: RecordingSource): string {
  if ('live' in of) return 'live=1';
  const [kind, value] = Object.entries(of)[0] as [string, number | readonly number[]];
  return `${kind}=${typeof value === 'number' ? value : writeIds(value).replaceAll(' ', '')}`;
}

/** Return the recording that a page URL requests: its URL on the server and a description; null if there is none. */
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

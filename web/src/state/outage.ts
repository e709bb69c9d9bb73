/** Text of the footer after an interruption of the stream. */
import { clock, span } from '../lib/format';

export interface Outage {
  lost_ms: number;
  back_ms: number;
  /** Recorded events that were fetched after the interruption. */
  events: { from: string; to: string; count: number };
  /** Start of the server before and after the interruption; null if it is not known. */
  before: string | null;
  after: string | null;
}

/** Return duration, fetched events, and whether the server was restarted, if both of its start times are known. */
export function outageText(o: Outage): string {
  const fetched = o.events.count
    ? `back-filled ${clock(o.events.from)} – ${clock(o.events.to)}`
    : 'no recorded event missed';
  return [`reconnected after ${span((o.back_ms - o.lost_ms) / 1000)}`, fetched, serverText(o)]
    .filter(Boolean)
    .join(', ');
}

function serverText(o: Outage): string {
  if (o.before === null || o.after === null) return '';
  return o.before === o.after
    ? 'the server was not restarted'
    : `the server was restarted (${clock(o.after)}); telemetry was not recorded while it was down`;
}

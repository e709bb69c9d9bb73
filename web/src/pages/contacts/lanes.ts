/** Lanes of a contact's timeline, and the description of its record. Times are in Unix seconds. */
import type { ContactDetail, ContactRecord } from '../../api/types';
import { counted, fixed, span } from '../../lib/format';
import type { LampState } from '../../lib/lamp';
import { lampOf } from '../../lib/lamp';
import { resultState } from '../../lib/stages';

export interface Mark {
  key: string;
  from: number;
  /** Equal to `from` for a point in time. */
  to: number;
  state: LampState;
  text: string;
}
export interface Lane {
  name: string;
  /** gaps: hatched parts of a full bar; ticks: points in time; bars: periods; boxes: frames. */
  kind: 'gaps' | 'ticks' | 'bars' | 'boxes';
  marks: Mark[];
}

const at = (iso: string): number => Date.parse(iso) / 1000;
const when = (iso: string): string => `${iso.slice(11, 19)}Z`;

export function lanes(c: ContactDetail, record: ContactRecord | null, endS: number): Lane[] {
  return [
    {
      name: 'telemetry',
      kind: 'gaps',
      marks: (record?.gaps ?? []).map((g) => ({
        key: g.start,
        from: at(g.start),
        to: at(g.end),
        state: g.explained ? 'unknown' : 'warning',
        text: `${when(g.start)} to ${when(g.end)}, ${counted(g.missing, 'packet')} missing: ${g.cause}`,
      })),
    },
    {
      name: 'commands',
      kind: 'ticks',
      marks: c.command_list.map((x) => ({
        key: String(x.id),
        from: at(x.created),
        to: at(x.created),
        state: resultState(x),
        text: `${when(x.created)} ${x.name} ${x.result}`,
      })),
    },
    {
      name: 'frames',
      kind: 'boxes',
      marks: c.frame_list.map((f) => ({
        key: String(f.id),
        from: at(f.received),
        to: at(f.received),
        state: 'progress',
        text: `${when(f.received)} ${f.name}`,
      })),
    },
    {
      name: 'transfers',
      kind: 'bars',
      marks: c.transfers.map((t) => ({
        key: String(t.id),
        from: at(t.created),
        to: t.finished ? at(t.finished) : endS,
        state: t.state === 'failed' ? 'critical' : 'progress',
        text: `${when(t.created)} ${t.subject}, ${t.direction}, ${t.state}`,
      })),
    },
    {
      name: 'alarms',
      kind: 'bars',
      marks: c.alarms.map((a) => ({
        key: String(a.id),
        from: at(a.raised),
        to: a.closed ? at(a.closed) : endS,
        state: lampOf(a.worst),
        text: `${when(a.raised)} ${a.worst}: ${a.title || a.field} ${a.limit_text}`,
      })),
    },
  ];
}

/** Return the percentage of the expected packets that are stored, rounded down: 100 only if no packet is missing. */
export function coverage(record: ContactRecord): string {
  return fixed(Math.floor(10_000 * record.share) / 100, 2);
}

const COUNTERS: Record<string, string> = {
  bytes: 'bytes received',
  good: 'packets received',
  bad_crc: 'packets with a bad checksum',
  too_long: 'packets too long',
  too_short: 'packets too short',
  unframed: 'bytes outside packets',
  unknown: 'packets of an unknown type',
  undecodable: 'packets not in the dictionary',
  gaps: 'packets missing by sequence count',
  duplicates: 'packets received twice',
  repeated_ids: 'repeated command reports',
  sent_good: 'packets sent',
  sent_bytes: 'bytes sent',
};

/** Return (label, value) of the counters of a contact. A counter without a label has its name. */
export function counterRows(counters: Record<string, number>): [string, number][] {
  return Object.entries(counters).map(([name, n]) => [COUNTERS[name] ?? name.replace(/_/g, ' '), n]);
}

/** Return a summary of the record, as in the pass report: "16 gaps, 18 packets missing, all explained". */
export function recordWords(record: ContactRecord): string {
  if (!record.gaps.length) return 'no gap';
  const missing = record.gaps.reduce((sum, g) => sum + g.missing, 0);
  const why = record.unexplained ? `${record.unexplained} unexplained` : 'all explained';
  return `${counted(record.gaps.length, 'gap')}, ${counted(missing, 'packet')} missing, ${why}`;
}

export const lengthOf = (g: { start: string; end: string }): string => span(at(g.end) - at(g.start));

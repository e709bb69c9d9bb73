/**
 * Requests to the embedded viewer in the format of its `viewer_control`: protobuf encoded by hand, because only one
 * message is sent.
 */

const text = new TextEncoder();

function varint(value: bigint): number[] {
  const out: number[] = [];
  let rest = BigInt.asUintN(64, value);
  while (rest > 127n) {
    out.push(Number(rest & 127n) | 128);
    rest >>= 7n;
  }
  return [...out, Number(rest)];
}

const bytes = (field: number, body: readonly number[]): number[] => [
  ...varint(BigInt((field << 3) | 2)),
  ...varint(BigInt(body.length)),
  ...body,
];
const number = (field: number, value: bigint): number[] => [...varint(BigInt(field << 3)), ...varint(value)];

/**
 * Moves the time cursor of the active recording: set_time_cursor { timeline { name }, time { time } } of the viewer's
 * control service.
 */
export function setTimeCursor(timeline: string, time: bigint): Uint8Array {
  const wanted = [...bytes(2, bytes(1, [...text.encode(timeline)])), ...bytes(3, number(1, time))];
  return Uint8Array.from(bytes(6, wanted));
}

export interface Picked {
  path: string;
  instance: number | null;
}
/** Events that the viewer sends to the page. */
export type ViewerEvent =
  { kind: 'opened' } | { kind: 'time'; timeline: string | null; time: number } | { kind: 'selection'; items: Picked[] };

/** Parses one of the viewer's events; null for events that the page does not use. */
export function readEvent(data: string): ViewerEvent | null {
  const e = JSON.parse(data) as {
    type?: string;
    time?: number;
    timeline?: string;
    timeline_name?: string;
    items?: { type?: string; entity_path?: string; instance_id?: number | null }[];
  };
  switch (e.type) {
    case 'recording_open':
      return { kind: 'opened' };
    case 'time_update':
      return { kind: 'time', timeline: null, time: Number(e.time) };
    case 'timeline_change':
      return { kind: 'time', timeline: e.timeline ?? e.timeline_name ?? null, time: Number(e.time) };
    case 'selection_change':
      return {
        kind: 'selection',
        items: (e.items ?? [])
          .filter((i) => i.type === 'entity' && i.entity_path)
          .map((i) => ({ path: (i.entity_path ?? '').replace(/^\//, ''), instance: i.instance_id ?? null })),
      };
    default:
      return null;
  }
}

/**
 * Splits a stream of pieces (length in four bytes, little endian, then a complete .rrd) at any chunk boundary. Empty
 * pieces are dropped.
 */
export class Pieces {
  private held = new Uint8Array(0);

  push(chunk: Uint8Array): Uint8Array[] {
    const all = new Uint8Array(this.held.length + chunk.length);
    all.set(this.held);
    all.set(chunk, this.held.length);
    const out: Uint8Array[] = [];
    let at = 0;
    while (all.length - at >= 4) {
      const length = new DataView(all.buffer, at, 4).getUint32(0, true);
      if (all.length - at - 4 < length) break;
      if (length) out.push(all.slice(at + 4, at + 4 + length));
      at += 4 + length;
    }
    this.held = all.slice(at);
    return out;
  }
}

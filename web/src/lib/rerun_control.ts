/**
 * Requests to the embedded viewer in the format of its `viewer_control`. The protobuf is encoded manually, because only
 * one message is needed.
 */

const text = new TextEncoder();

function varint(value: bigint): number[] {
  const out: number[] = [];
  let remaining = BigInt.asUintN(64, value);
  while (remaining > 127n) {
    out.push(Number(remaining & 127n) | 128);
    remaining >>= 7n;
  }
  return [...out, Number(remaining)];
}

const bytes = (field: number, body: readonly number[]): number[] => [
  ...varint(BigInt((field << 3) | 2)),
  ...varint(BigInt(body.length)),
  ...body,
];
const number = (field: number, value: bigint): number[] => [...varint(BigInt(field << 3)), ...varint(value)];

/**
 * Return the request that moves the time cursor of the active recording: set_time_cursor { timeline { name }, time {
 * time } } of the viewer's control service.
 */
export function setTimeCursor(timeline: string, time: bigint): Uint8Array {
  const message = [...bytes(2, bytes(1, [...text.encode(timeline)])), ...bytes(3, number(1, time))];
  return Uint8Array.from(bytes(6, message));
}

export interface Picked {
  path: string;
  instance: number | null;
}
/** Events that the viewer sends to the page. */
export type ViewerEvent =
  { kind: 'opened' } | { kind: 'time'; timeline: string | null; time: number } | { kind: 'selection'; items: Picked[] };

/** Parse an event of the viewer. Returns null for events that the page does not use. */
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
 * Split a stream into pieces, wherever its chunks end. Each piece is a length in four bytes, little endian, followed by
 * a complete .rrd. Empty pieces are dropped.
 */
export class Pieces {
  private buffer = new Uint8Array(0);

  push(chunk: Uint8Array): Uint8Array[] {
    const all = new Uint8Array(this.buffer.length + chunk.length);
    all.set(this.buffer);
    all.set(chunk, this.buffer.length);
    const out: Uint8Array[] = [];
    let at = 0;
    while (all.length - at >= 4) {
      const length = new DataView(all.buffer, at, 4).getUint32(0, true);
      if (all.length - at - 4 < length) break;
      if (length) out.push(all.slice(at + 4, at + 4 + length));
      at += 4 + length;
    }
    this.buffer = all.slice(at);
    return out;
  }
}

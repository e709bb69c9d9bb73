import { describe, expect, it } from 'vitest';
import { Pieces, readEvent, setTimeCursor } from './rerun_control';

describe('messages to the viewer', () => {
  it('are set_time_cursor in protobuf wire format', () => {
    // Fields 6, 2.1 and 3.1 of viewer_control.proto: set_time_cursor { timeline { name: "frame" } time { time: 300 } }
    const want = [0x32, 0x0e, 0x12, 0x07, 0x0a, 0x05, 0x66, 0x72, 0x61, 0x6d, 0x65, 0x1a, 0x03, 0x08, 0xac, 0x02];
    expect([...setTimeCursor('frame', 300n)]).toEqual(want);
  });
  it('support present times in nanoseconds and negative times', () => {
    expect(setTimeCursor('utc', 1_795_000_000_000_000_000n).length).toBeLessThan(30);
    expect([...setTimeCursor('t', -1n)].slice(-10)).toEqual([255, 255, 255, 255, 255, 255, 255, 255, 255, 1]);
  });
});

describe('events of the viewer', () => {
  it('name the selected entity and instance', () => {
    const e = readEvent(
      '{"type":"selection_change","items":[{"type":"view"},' +
        '{"type":"entity","entity_path":"/camera/image/matched","instance_id":3}]}',
    );
    expect(e).toEqual({ kind: 'selection', items: [{ path: 'camera/image/matched', instance: 3 }] });
  });
  it('report times; others are ignored', () => {
    expect(readEvent('{"type":"time_update","time":42}')).toEqual({ kind: 'time', timeline: null, time: 42 });
    expect(readEvent('{"type":"play"}')).toBeNull();
  });
});

describe('pieces of a live recording', () => {
  it('are complete, however the network splits them', () => {
    const framed = (n: number, value: number): number[] => [n & 255, n >> 8, 0, 0, ...Array<number>(n).fill(value)];
    const wire = Uint8Array.from([...framed(300, 1), ...framed(0, 0), ...framed(5, 2)]);
    for (const step of [1, 3, 7, 301, 1000]) {
      const pieces = new Pieces();
      const got: number[] = [];
      for (let i = 0; i < wire.length; i += step)
        for (const p of pieces.push(wire.slice(i, i + step))) got.push(p.length, p[0] ?? 0);
      expect(got).toEqual([300, 1, 5, 2]);
    }
  });
});

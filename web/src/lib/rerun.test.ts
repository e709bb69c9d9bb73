import { describe, expect, it } from 'vitest';
import { Pieces, readEvent, setTimeCursor } from './rerun_control';

describe('what the page says to the viewer', () => {
  it('is the protobuf of set_time_cursor by the rules of the wire format', () => {
    // Fields 6, 2.1 and 3.1 of viewer_control.proto: set_time_cursor { timeline { name: "frame" } time { time: 300 } }
    const want = [0x32, 0x0e, 0x12, 0x07, 0x0a, 0x05, 0x66, 0x72, 0x61, 0x6d, 0x65, 0x1a, 0x03, 0x08, 0xac, 0x02];
    expect([...setTimeCursor('frame', 300n)]).toEqual(want);
  });
  it('carries nanoseconds of today and negative times', () => {
    expect(setTimeCursor('utc', 1_795_000_000_000_000_000n).length).toBeLessThan(30);
    expect([...setTimeCursor('t', -1n)].slice(-10)).toEqual([255, 255, 255, 255, 255, 255, 255, 255, 255, 1]);
  });
});

describe('what the viewer says to the page', () => {
  it('names the entity and the instance that a person picked', () => {
    const e = readEvent('{"type":"selection_change","items":[{"type":"view"},{"type":"entity","entity_path":"/camera/image/matched","instance_id":3}]}');
    expect(e).toEqual({ kind: 'selection', items: [{ path: 'camera/image/matched', instance: 3 }] });
  });
  it('tells times, and is silent about the rest', () => {
    expect(readEvent('{"type":"time_update","time":42}')).toEqual({ kind: 'time', timeline: null, time: 42 });
    expect(readEvent('{"type":"play"}')).toBeNull();
  });
});

describe('pieces of a live recording', () => {
  it('come out whole, whatever the network made of them', () => {
    const framed = (n: number, value: number): number[] => [n & 255, n >> 8, 0, 0, ...Array<number>(n).fill(value)];
    const wire = Uint8Array.from([...framed(300, 1), ...framed(0, 0), ...framed(5, 2)]);
    for (const step of [1, 3, 7, 301, 1000]) {
      const pieces = new Pieces();
      const got: number[] = [];
      for (let i = 0; i < wire.length; i += step) for (const p of pieces.push(wire.slice(i, i + step))) got.push(p.length, p[0] ?? 0);
      expect(got).toEqual([300, 1, 5, 2]);
    }
  });
});

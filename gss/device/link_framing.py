"""Extract the packets of a sensor from a byte stream, with the framings of ``link.yaml``."""

from __future__ import annotations

from collections.abc import Sequence

from gss.device.protocol.codec import STRUCTS
from gss.device.protocol.framing import MAX_PACKET_BYTES
from gss.device.protocol.receiver import Deframer
from gss.device.protocol.sender import encode_frame
from gss.instruments.link_file import LinkFile, PacketFormat, Protocol


class DelimitedFramer(Deframer):
    """Framer for packets between delimiters: cobs, slip, kiss."""

    def __init__(self, framing: str) -> None:
        super().__init__(framing=framing)
        self._name = framing

    def encode(self, packet: bytes) -> bytes:
        """Return the frame of a packet."""
        return encode_frame(packet, self._name)

    def feed(self, data: bytes, sizes: Sequence[int] = ()) -> list[bytes]:
        """Return the packets that ``data`` completes."""
        return super().feed(data)


class CutFramer:
    """Framer for packets with marks or a known length. Bytes that do not fit are dropped one at a time.

    ``sync`` and ``trailer`` may be empty. The size of a packet is stated in its header, or is the smallest fitting size
    of those passed to ``feed``. If neither is known, the bytes of one read form one packet.
    """

    def __init__(self, sync: bytes, trailer: bytes, header: PacketFormat | None, order: str) -> None:
        self._sync, self._trailer, self._order = sync, trailer, order
        self._length = next((f for f in header.header if f.holds == "length"), None) if header else None
        self._length_at = header.offset(self._length.name) if header and self._length else 0
        self._buffer = b""
        self.bytes = self.unframed = self.too_long = self.broken = 0

    def restart(self) -> None:
        """Discard the partial packet. The counters do not change."""
        self._buffer = b""

    def encode(self, packet: bytes) -> bytes:
        """Return the frame of a packet."""
        return self._sync + packet + self._trailer

    def feed(self, data: bytes, sizes: Sequence[int] = ()) -> list[bytes]:
        """Return the packets that ``data`` completes; only the first one if ``sizes`` is not empty. ``sizes``: possible
        packet sizes without sync and trailer, in bytes; empty if the header states the size or a read is one packet."""
        self.bytes += len(data)
        if not self._sync and self._length is None and not sizes:
            packet, self._buffer = self._buffer + data, b""
            return [packet] if packet else []
        self._buffer += data
        packets = []
        while self._buffer:
            at = self._buffer.find(self._sync)
            if at < 0:
                keep = min(len(self._sync) - 1, len(self._buffer))  # the start of a mark can be at the end
                tail = self._buffer[len(self._buffer) - keep :]
                self.unframed += len(self._buffer) - len(tail)
                self._buffer = tail
                break
            self._drop(at)
            size = self._size(sizes)
            if size is None:
                break
            if size == 0:
                self.broken += 1
                self._drop(1)
                continue
            start = len(self._sync)
            packets.append(self._buffer[start : start + size])
            self._buffer = self._buffer[start + size + len(self._trailer) :]
            if sizes:  # the next packet can have another size
                break
        return packets

    def _drop(self, count: int) -> None:
        self.unframed += count
        self._buffer = self._buffer[count:]

    def _size(self, sizes: Sequence[int]) -> int | None:
        """Return the size of the packet at the start; 0 if there is none, None if more bytes are needed."""
        start, marks = len(self._sync), len(self._sync) + len(self._trailer)
        if self._length is not None:
            number = STRUCTS[self._order][self._length.type]
            end = start + self._length_at + number.size
            if len(self._buffer) < end:
                return None
            size = number.unpack_from(self._buffer, end - number.size)[0] - self._length.add
            if not self._length_at < size <= MAX_PACKET_BYTES:
                self.too_long += size > MAX_PACKET_BYTES
                return 0
            sizes = (size,)
        waiting = False
        for size in sorted(sizes):
            if len(self._buffer) < size + marks:
                waiting = True
            elif self._buffer[start + size : size + marks] == self._trailer:
                return size
        return None if waiting else 0


Framer = DelimitedFramer | CutFramer


def framer_of(link: LinkFile, protocol: Protocol, order: str) -> Framer:
    """Create the framer of a line."""
    if link.framing in ("cobs", "slip", "kiss"):
        return DelimitedFramer(link.framing)
    prefixed = link.framing == "length_prefixed"
    sync, trailer = (bytes.fromhex(mark or "") for mark in (protocol.sync, protocol.trailer))
    return CutFramer(sync, trailer, protocol.response if prefixed else None, order)

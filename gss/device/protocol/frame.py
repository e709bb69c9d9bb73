"""Frames on a byte stream: ``00`` + COBS(packet) + ``00``.

A delimiter on both sides costs one byte and keeps every damage inside the frame it hits: were neighbours to share one
delimiter, a flipped delimiter would lose both.
"""

from __future__ import annotations

from cobs import cobs

MAX_PACKET_BYTES = 2048
"""Largest packet before COBS; both ends drop what is longer before it fills memory."""


def encoded_limit(max_packet_bytes: int = MAX_PACKET_BYTES) -> int:
    """Longest COBS form of a packet: one code byte per started 254 bytes."""
    return max_packet_bytes + max_packet_bytes // 254 + 1


def encode_frame(packet: bytes) -> bytes:
    """Frame with both delimiters."""
    return b"\0" + bytes(cobs.encode(packet)) + b"\0"


class Deframer:
    """Cuts a stream into packets. Holds at most one longest frame; never raises.

    ``bytes``: everything fed. ``unframed``: bytes before the first delimiter. ``too_long``, ``bad_cobs``: frames lost.
    """

    def __init__(self, max_packet_bytes: int = MAX_PACKET_BYTES) -> None:
        self._limit = encoded_limit(max_packet_bytes)
        self._held = bytearray()
        self._overflow = False
        self._synced = False
        self.bytes = self.unframed = self.too_long = self.bad_cobs = 0

    def restart(self) -> None:
        """A new stream: forget the half frame, wait for a delimiter. Counters stay."""
        self._held.clear()
        self._overflow = self._synced = False

    @property
    def held_bytes(self) -> int:
        """Memory in use, never above the longest frame."""
        return len(self._held)

    def feed(self, data: bytes) -> list[bytes]:
        """Packets that ``data`` completes; empty frames between double delimiters are no frames."""
        self.bytes += len(data)
        pieces = data.split(b"\0")
        packets = []
        for piece in pieces[:-1]:
            self._append(piece)
            packet = self._close()
            if packet is not None:
                packets.append(packet)
        self._append(pieces[-1])
        return packets

    def _append(self, piece: bytes) -> None:
        if not self._synced:
            self.unframed += len(piece)
        elif self._overflow or len(self._held) + len(piece) > self._limit:
            self._overflow = True
            self._held.clear()
        else:
            self._held += piece

    def _close(self) -> bytes | None:
        """A delimiter came: what does the buffer hold?"""
        self._synced = True
        if self._overflow:
            self._overflow = False
            self.too_long += 1
            return None
        if not self._held:
            return None
        try:
            return bytes(cobs.decode(bytes(self._held)))
        except cobs.DecodeError:
            self.bad_cobs += 1
            return None
        finally:
            self._held.clear()

"""Framing on a byte stream, by two plug-ins: ``cobs`` (default) and ``slip``.

cobs: ``00`` + COBS(packet) + ``00``. slip (RFC 1055): ``C0`` + packet with C0 as DB DC and DB as DB DD + ``C0``.

A delimiter on both sides costs one byte and confines damage to one frame: if adjacent frames shared a delimiter, one
damaged delimiter would lose both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cobs import cobs

from gss.domain.errors import BadInput

MAX_PACKET_BYTES = 2048
"""Largest packet before framing; both ends drop longer ones before they fill memory."""

SLIP_END, SLIP_ESCAPE = b"\xc0", b"\xdb"
SLIP_ESCAPED_END, SLIP_ESCAPED_ESCAPE = b"\xdb\xdc", b"\xdb\xdd"


class BrokenFrame(ValueError):
    """The bytes between two delimiters are not an encoded packet."""


def encoded_limit(max_packet_bytes: int = MAX_PACKET_BYTES) -> int:
    """Return the maximum COBS-encoded length of a packet: one extra byte per started 254 bytes."""
    return max_packet_bytes + max_packet_bytes // 254 + 1


def _cobs_decode(body: bytes) -> bytes:
    try:
        return bytes(cobs.decode(body))
    except cobs.DecodeError as error:
        raise BrokenFrame(str(error)) from error


def _slip_encode(packet: bytes) -> bytes:
    return packet.replace(SLIP_ESCAPE, SLIP_ESCAPED_ESCAPE).replace(SLIP_END, SLIP_ESCAPED_END)


def _slip_decode(body: bytes) -> bytes:
    pieces = body.split(SLIP_ESCAPE)
    decoded = [pieces[0]]
    for piece in pieces[1:]:
        if piece[:1] not in (SLIP_ESCAPED_END[1:], SLIP_ESCAPED_ESCAPE[1:]):
            raise BrokenFrame("escape without a known second byte")
        decoded.append((SLIP_END if piece[:1] == SLIP_ESCAPED_END[1:] else SLIP_ESCAPE) + piece[1:])
    return b"".join(decoded)


@dataclass(frozen=True)
class Framing:
    """A method to delimit packets. ``decode`` raises BrokenFrame; ``limit``: maximum encoded length for a packet length."""

    delimiter: bytes
    encode: Callable[[bytes], bytes]
    decode: Callable[[bytes], bytes]
    limit: Callable[[int], int]


FRAMINGS = {
    "cobs": Framing(b"\0", lambda packet: bytes(cobs.encode(packet)), _cobs_decode, encoded_limit),
    "slip": Framing(SLIP_END, _slip_encode, _slip_decode, lambda max_packet_bytes: 2 * max_packet_bytes),
}


def framing_named(name: str) -> Framing:
    """Return the framing of that name. Raises BadInput listing the valid names."""
    if name not in FRAMINGS:
        raise BadInput("unknown framing", expected=" | ".join(FRAMINGS), got=name)
    return FRAMINGS[name]


def encode_frame(packet: bytes, framing: str = "cobs") -> bytes:
    """Return the frame of a packet, with both delimiters."""
    how = framing_named(framing)
    return how.delimiter + how.encode(packet) + how.delimiter


class Deframer:
    """Splits a byte stream into packets. Buffers at most one frame of maximum length; never raises.

    Counters: ``bytes`` received in total, ``unframed`` bytes before the first delimiter, ``too_long`` and ``broken``
    frames.
    """

    def __init__(self, max_packet_bytes: int = MAX_PACKET_BYTES, framing: str = "cobs") -> None:
        self._how, self._longest = framing_named(framing), max_packet_bytes
        self._limit = self._how.limit(max_packet_bytes)
        self._held = bytearray()
        self._overflow = False
        self._synced = False
        self.bytes = self.unframed = self.too_long = self.broken = 0

    def restart(self) -> None:
        """Start a new stream: discard the partial frame and wait for a delimiter. Counters are kept."""
        self._held.clear()
        self._overflow = self._synced = False

    @property
    def held_bytes(self) -> int:
        """Bytes in the buffer, at most one frame of maximum length."""
        return len(self._held)

    def feed(self, data: bytes) -> list[bytes]:
        """Return the packets that ``data`` completes. Empty frames between adjacent delimiters are ignored."""
        self.bytes += len(data)
        pieces = data.split(self._how.delimiter)
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
        """Decode the buffered frame at a delimiter. Returns None if it is empty or invalid."""
        self._synced = True
        if self._overflow:
            self._overflow = False
            self.too_long += 1
            return None
        if not self._held:
            return None
        try:
            packet = self._how.decode(bytes(self._held))
        except BrokenFrame:
            self.broken += 1
            return None
        finally:
            self._held.clear()
        if len(packet) > self._longest:
            self.too_long += 1
            return None
        return packet

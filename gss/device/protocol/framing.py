"""Framing on a byte stream: ``cobs`` (default), ``slip`` and ``kiss``.

cobs: ``00`` + COBS(packet) + ``00``.

slip (RFC 1055): ``C0`` + packet + ``C0``. Within the packet, C0 is replaced by DB DC, and DB by DB DD.

kiss (Chepponis & Karn 1987): slip with one more byte before the packet. The byte ``00`` marks data for the first port.
Frames with another byte are dropped.

Each frame has a delimiter on both sides. This costs one byte per frame, but if adjacent frames shared a delimiter,
damage to the delimiter would destroy both frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cobs import cobs

from gss.domain.errors import BadInput

MAX_PACKET_BYTES = 2048
"""Largest packet before framing; both ends drop longer packets to limit memory use."""

SLIP_END, SLIP_ESCAPE = b"\xc0", b"\xdb"
KISS_DATA = b"\0"
SLIP_ESCAPED_END, SLIP_ESCAPED_ESCAPE = b"\xdb\xdc", b"\xdb\xdd"


class BrokenFrame(ValueError):
    """Raised when the bytes between two delimiters are not an encoded packet."""


def encoded_limit(max_packet_bytes: int = MAX_PACKET_BYTES) -> int:
    """Return an upper limit for the COBS-encoded length of a packet: one extra byte, and one per complete 254 bytes."""
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
            raise BrokenFrame("invalid byte after an escape")
        decoded.append((SLIP_END if piece[:1] == SLIP_ESCAPED_END[1:] else SLIP_ESCAPE) + piece[1:])
    return b"".join(decoded)


def _kiss_decode(body: bytes) -> bytes:
    packet = _slip_decode(body)
    if packet[:1] != KISS_DATA:
        raise BrokenFrame("not a data frame for the first port")
    return packet[1:]


@dataclass(frozen=True)
class Framing:
    """A framing method. ``decode`` raises BrokenFrame; ``limit``: maximum encoded length for a packet length."""

    delimiter: bytes
    encode: Callable[[bytes], bytes]
    decode: Callable[[bytes], bytes]
    limit: Callable[[int], int]


FRAMINGS = {
    "cobs": Framing(b"\0", lambda packet: bytes(cobs.encode(packet)), _cobs_decode, encoded_limit),
    "slip": Framing(SLIP_END, _slip_encode, _slip_decode, lambda max_packet_bytes: 2 * max_packet_bytes),
    "kiss": Framing(SLIP_END, lambda p: _slip_encode(KISS_DATA + p), _kiss_decode, lambda most: 2 * most + 1),
}


def framing_named(name: str) -> Framing:
    """Return a framing by its name. Raises BadInput listing the valid names."""
    if name not in FRAMINGS:
        raise BadInput("unknown framing", expected=" | ".join(FRAMINGS), got=name)
    return FRAMINGS[name]

"""Authenticate packets to the device: key slot, counter and truncated HMAC-SHA-256 at the end of the packet.

The trailer precedes the CRC: u8 key slot, u64 counter, 16 bytes of HMAC-SHA-256 over everything before them (RFC 2104,
truncated as RFC 2104 §5 permits). The device accepts a counter only if it is higher than all counters that it accepted
before. There are two slots, so the key in one slot can be replaced while the key in the other slot is active.
"""

from __future__ import annotations

import hmac
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gss.device.protocol.packet import CRC_BYTES, TRAILER_BYTES
from gss.domain.errors import BadInput

HEAD = struct.Struct(">BQ")
MAC_BYTES = 16
KEY_BYTES = 32
SLOTS = (0, 1)


@dataclass(frozen=True, repr=False)
class LinkKeys:
    """Keys of both ends by slot, 32 bytes each. ``active``: slot of the key with which the ground signs. Raises
    BadInput for invalid slots or lengths."""

    keys: Mapping[int, bytes]
    active: int

    def __post_init__(self) -> None:
        """Validate slots and lengths."""
        if not self.keys or set(self.keys) - set(SLOTS):
            raise BadInput("wrong key slots", expected="slot 0, 1 or both", got=", ".join(map(str, sorted(self.keys))))
        for slot, key in self.keys.items():
            if len(key) != KEY_BYTES:
                raise BadInput(
                    f"the key in slot {slot} has a wrong length", expected="32 bytes", got=f"{len(key)} bytes"
                )
        if self.active not in self.keys:
            raise BadInput("the active slot has no key", got=str(self.active))


def _mac(key: bytes, signed: bytes) -> bytes:
    return hmac.digest(key, signed, "sha256")[:MAC_BYTES]


class PacketSigner:
    """Signs packets on the ground. ``counter``: returns a number higher than all numbers returned before, also across
    restarts."""

    def __init__(self, keys: LinkKeys, counter: Callable[[], int]) -> None:
        self._slot, self._key, self._counter = keys.active, keys.keys[keys.active], counter

    def trailer(self, body: bytes) -> bytes:
        """Return the trailer of a packet. ``body``: bytes of the packet up to the end of its payload."""
        head = HEAD.pack(self._slot, self._counter())
        return head + _mac(self._key, body + head)


class PacketVerifier:
    """Verifies packets on the device. ``accepted``: highest accepted counter; the owner stores it across restarts."""

    def __init__(self, keys: LinkKeys, accepted: int) -> None:
        self._keys, self.accepted = keys.keys, accepted

    def accepts(self, frame: bytes) -> bool:
        """True if the packet has a valid trailer with a new counter. ``frame``: an intact packet with its CRC."""
        body, trailer = frame[: -CRC_BYTES - TRAILER_BYTES], frame[-CRC_BYTES - TRAILER_BYTES : -CRC_BYTES]
        head, mac = trailer[: HEAD.size], trailer[HEAD.size :]
        slot, counter = HEAD.unpack(head)
        key = self._keys.get(slot)
        if key is None or not hmac.compare_digest(_mac(key, body + head), mac) or counter <= self.accepted:
            return False
        self.accepted = counter
        return True

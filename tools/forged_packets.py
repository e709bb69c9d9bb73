"""Send forged and replayed packets to a receiver with link keys and count the accepted packets. None must be accepted.

``python -m tools.forged_packets 1000000``
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

import numpy as np

from gss.device.protocol.authentication import LinkKeys, PacketSigner, PacketVerifier
from gss.device.protocol.packet import CRC_BYTES, TRAILER_BYTES, Packet, PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.device.protocol.sender import encode_frame, encode_packet, with_crc

OLD = 1_000


def forged(keys: LinkKeys, number: int, rng: np.random.Generator) -> Iterator[bytes]:
    """Yield forged or replayed frames with a valid CRC: changed bits in body, counter or code, trailers of other
    packets, random trailers, unsigned packets, and valid packets with an old counter."""
    counters = iter(range(1, OLD))
    signer = PacketSigner(keys, lambda: next(counters))
    packets = [
        encode_packet(Packet(PacketType.COMMAND, int(rng.integers(1, 60)), n, rng.bytes(8), 0x1234, True), signer)[
            :-CRC_BYTES
        ]
        for n in range(1, OLD)
    ]
    for n in range(number):
        data = bytearray(packets[int(rng.integers(len(packets)))])
        kind = n % 6
        if kind == 0:  # one changed bit at a random position, with a new counter
            data[-TRAILER_BYTES + 1 : -TRAILER_BYTES + 9] = (10**9 + n).to_bytes(8, "big")
            data[int(rng.integers(6, len(data)))] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[-TRAILER_BYTES:] = packets[int(rng.integers(len(packets)))][-TRAILER_BYTES:]
            data[-TRAILER_BYTES + 1 : -TRAILER_BYTES + 9] = (10**9 + n).to_bytes(8, "big")
        elif kind == 2:
            data[-16:] = rng.bytes(16)
        elif kind == 3:
            data[-TRAILER_BYTES:] = bytes([int(rng.integers(2))]) + (10**9 + n).to_bytes(8, "big") + rng.bytes(16)
        elif kind == 4:
            packet = Packet(PacketType.COMMAND, int(rng.integers(256)), n + 1, rng.bytes(8), 0x1234, True)
            data = bytearray(encode_packet(packet)[:-CRC_BYTES])
        yield encode_frame(with_crc(bytes(data)))  # the sixth kind is an unchanged replay


def main(number: int) -> int:
    """Run the test and print the result. Return 1 if a packet was accepted."""
    keys = LinkKeys({0: bytes(range(32)), 1: bytes(range(32, 64))}, 0)
    receiver = LineReceiver(from_device=False, verifier=PacketVerifier(keys, OLD))
    started = time.process_time()
    accepted = sum(len(receiver.feed(frame)) for frame in forged(keys, number, np.random.default_rng(1)))
    print(
        f"{number} forged or replayed packets: {accepted} accepted, {receiver.unauthenticated} unauthenticated, "
        f"{receiver.unknown + receiver.too_short} malformed; {time.process_time() - started:.0f} s of processor time"
    )
    return 1 if accepted else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))

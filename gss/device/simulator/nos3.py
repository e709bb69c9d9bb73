"""Simulated generic star tracker of NOS3, written from public facts (github.com/nasa-itc/generic_star_tracker,
144a4e0).

It sends packets only in response to requests. Documented behaviour: the counter advances once per well-formed request
and once more per response; unknown requests have no response; an invalid attitude repeats the numbers of the last valid
attitude.
"""

from __future__ import annotations

import struct
from collections import deque

import numpy as np

from gss.device.link_framing import CutFramer
from gss.device.simulator.other_makers import UnitWorld, check_dialects, measured

SYNC, TRAILER = b"\xde\xad", b"\xbe\xef"
REQUEST = struct.Struct(">BI")
NOOP, HOUSEKEEPING, DATA = 0, 1, 2
README_OPCODES = {0: HOUSEKEEPING, 1: DATA}
SAMPLE_S = 0.25
SIGMA_ARCSEC = (2.0, 2.0, 20.0)
FASTEST_RAD_S = float(np.radians(1.0))
"""Angular rate above which the attitude is invalid. Chosen."""
TEST_PATTERN, README, BURSTS, DISABLED = "test-pattern", "readme", "one-write-one-command", "disabled"
DIALECTS = (TEST_PATTERN, README, BURSTS, DISABLED)


def open_unit(world: UnitWorld) -> Nos3Unit:
    """Create the unit. Raises BadInput for an unknown dialect."""
    check_dialects(world.dialects, DIALECTS)
    return Nos3Unit(world)


class Nos3Unit:
    """Simulated unit. Dialects: ``test-pattern`` sends the n-th quaternion n·(0.001, 0.002, 0.003, 0.004), not
    normalised, which overflows; ``readme`` has the numbers and lengths of the README; ``one-write-one-command`` drops
    requests that arrive together; ``disabled`` sends no response."""

    def __init__(self, world: UnitWorld) -> None:
        self._world, self._counter, self._requests = world, 0, 0
        self._framer = CutFramer(SYNC, TRAILER, None, ">")
        self._out: deque[bytes] = deque()
        self._last: tuple[float, bytes] = (-1.0, b"\x80\x00" * 4 + b"\x00")

    def feed(self, data: bytes, now_s: float) -> None:
        """Process received bytes."""
        if self._on(DISABLED) or (self._on(BURSTS) and len(data) != len(SYNC + TRAILER) + REQUEST.size):
            return
        packets = self._framer.feed(data, (REQUEST.size,))
        while packets:
            for packet in packets:
                self._handle_request(packet, now_s)
            packets = self._framer.feed(b"", (REQUEST.size,))

    def _on(self, dialect: str) -> bool:
        return dialect in self._world.dialects

    def _handle_request(self, packet: bytes, now_s: float) -> None:
        opcode, _ = REQUEST.unpack(packet)
        self._count()
        if self._on(README):
            opcode = README_OPCODES.get(opcode, -1)
        if opcode not in (NOOP, HOUSEKEEPING, DATA):
            return
        self._send(packet)
        if opcode == HOUSEKEEPING:
            counter = bytes(8) if self._on(README) else b""
            self._send(struct.pack(">I", self._counter) + counter)
        elif opcode == DATA:
            self._requests += 1
            counter = struct.pack(">I", self._counter) if self._on(README) else b""
            self._send(self._data(now_s) + counter)
        self._count()

    def _count(self) -> None:
        self._counter = (self._counter + 1) & 0xFFFF_FFFF

    def _send(self, packet: bytes) -> None:
        self._out.append(SYNC + packet + TRAILER)

    def _data(self, now_s: float) -> bytes:
        if self._on(TEST_PATTERN):
            return quaternion_bytes([self._requests * step for step in (0.001, 0.002, 0.003, 0.004)]) + b"\x01"
        sample_s = int(now_s / SAMPLE_S) * SAMPLE_S
        if sample_s != self._last[0]:
            quaternion, rate_rad_s = measured(self._world, sample_s, SIGMA_ARCSEC)
            valid = float(np.linalg.norm(rate_rad_s)) <= FASTEST_RAD_S
            numbers = quaternion_bytes([float(q) for q in quaternion]) if valid else self._last[1][:-1]
            self._last = sample_s, numbers + bytes([valid])
        return self._last[1]

    def advance(self, now_s: float) -> None:
        """Do nothing: the unit only responds to requests."""

    def next_frame(self, now_s: float) -> bytes | None:
        """Return the next frame to send, or None."""
        return self._out.popleft() if self._out else None

    def shut_down(self, now_s: float) -> None:
        """Do nothing: the unit stores no state."""


def quaternion_bytes(quaternion: list[float]) -> bytes:
    """Return the four components scaled as by the sensor: truncated, and wrapped around on overflow."""
    return struct.pack(">4H", *(int(q * 32767 + 32768) & 0xFFFF for q in quaternion))

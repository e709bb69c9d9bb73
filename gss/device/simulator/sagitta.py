"""Simulated Sagitta of arcsec, written from public facts (ut-issl/c2a-aobc and s2e-aobc). Not compared with a unit.

It starts in its bootloader, in which it answers actions and parameters. It sends telemetry only after BOOT. Parameters
keep the values that were set; subscribed telemetry is sent at the interval of the camera.
"""

from __future__ import annotations

import struct
from collections import deque

import numpy as np

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.device.link_framing import DelimitedFramer
from gss.device.protocol.codec import LITTLE, encode, fixed_bytes
from gss.device.sagitta_driver import (
    ACTION,
    ASYNCHRONOUS,
    NOT_IMPLEMENTED,
    PARAMETER_CODES,
    READ_PARAMETER,
    REPLY,
    REQUEST_TELEMETRY,
    SET_PARAMETER,
    STAMP,
    packet,
    unpacked,
)
from gss.device.simulator.other_makers import UnitWorld, check_dialects, measured
from gss.domain.angles import Array
from gss.instruments.dictionary.definitions import Value

PING, BOOT, REBOOT, SET_TIME, TAKE_FRAME = 0, 1, 7, 14, 15
SOLUTION, TEMPERATURE, CENTROIDS, MATCHES = 24, 27, 37, 40
MOUNTING, CAMERA, SUBSCRIPTION = 6, 9, 18
SIGMA_ARCSEC = (2.0, 2.0, 10.0)
SIGMA_PX = 0.15
"""Error of a star's position per axis. With 16 stars it is equivalent to ``SIGMA_ARCSEC``."""
FASTEST_RAD_S = float(np.radians(1.0))
SEND_S = 0.2
ROWS = 16
FAINTEST_MAG = 6.0
FAILED = 2
BOOTED = "booted"
DIALECTS = (BOOTED,)
DEFAULTS = {
    MOUNTING: struct.pack("<4f", 1.0, 0.0, 0.0, 0.0),
    CAMERA: struct.pack("<B3fhBB16BI", 1, 25.0, 0.075, 0.1, 0, 0, 0, *([0] * 16), 0),
}


def open_unit(world: UnitWorld) -> SagittaUnit:
    """Create the unit. Raises BadInput for an unknown dialect."""
    check_dialects(world.dialects, DIALECTS)
    return SagittaUnit(world)


class SagittaUnit:
    """Simulated unit. Dialect ``booted``: the main program runs from the start."""

    def __init__(self, world: UnitWorld) -> None:
        self._world, self._framer = world, DelimitedFramer("slip")
        self._catalogue = propagate(load_stars(FAINTEST_MAG), world.environment.epoch_jyear)
        self._packets = {row.code: row for row in world.instrument.dictionary.telemetry}
        self._set: dict[int, bytes] = {}
        self._running = BOOTED in world.dialects
        self._offset_us, self._counter, self._stable = 0, 0, 0
        self._next_s = 0.0
        self._out: deque[bytes] = deque()

    def feed(self, data: bytes, now_s: float) -> None:
        """Process received bytes; damaged packets are not answered."""
        for frame in self._framer.feed(data):
            message = unpacked(frame)
            if message is not None:
                self._handle_request(*message, now_s)

    def _handle_request(self, kind: int, number: int, content: bytes, now_s: float) -> None:
        if kind == ACTION:
            self._send(REPLY | ACTION, number, self._act(number, content, now_s))
        elif kind == SET_PARAMETER:
            status = 0 if len(content) == self._parameter_bytes(number) else FAILED
            if not status:
                self._set[number] = content
            self._send(REPLY | SET_PARAMETER, number, bytes([status]))
        elif kind == READ_PARAMETER:
            size = self._parameter_bytes(number)
            value = self._set.get(number, DEFAULTS.get(number, bytes(size)))
            self._send(REPLY | READ_PARAMETER, number, value)
        elif kind == REQUEST_TELEMETRY and self._running:
            self._send(REPLY | REQUEST_TELEMETRY, number, self._telemetry(number, now_s))

    def _act(self, number: int, content: bytes, now_s: float) -> bytes:
        if number == PING and len(content) == 4:
            return b"\0" + content
        if number == BOOT and content == b"\1":
            self._running = True
        elif number == REBOOT and not content:
            self._running, self._stable = False, 0
        elif number == SET_TIME and len(content) == 8:
            self._offset_us = int.from_bytes(content, "little") - int(now_s * 1e6)
        elif number != TAKE_FRAME or len(content) != 1:
            return bytes([NOT_IMPLEMENTED])
        return b"\0"

    def _parameter_bytes(self, number: int) -> int:
        row = self._packets.get(PARAMETER_CODES + number)
        return fixed_bytes(row.fields) if row is not None else 0

    def _send(self, kind: int, number: int, content: bytes) -> None:
        self._out.append(self._framer.encode(packet(kind, number, content)))

    # --- telemetry ------------------------------------------------------------------------------------------------

    def _telemetry(self, number: int, now_s: float) -> bytes:
        row = self._packets.get(number)
        if row is None or number >= PARAMETER_CODES:
            return bytes([NOT_IMPLEMENTED])
        self._counter += 1
        time_us = (int(now_s * 1e6) + self._offset_us) & 0xFFFF_FFFF_FFFF_FFFF
        stamp = STAMP.pack(0, self._counter & 0xFFFF_FFFF, time_us)
        values: dict[str, Value] = {f.name: _zero(f.type) for f in row.values}
        rows: list[dict[str, Value]] = []
        if number == SOLUTION:
            values |= self._solution(now_s)
        elif number == TEMPERATURE:
            values |= {"mcu_c": 26.0, "cmos_c": 24.0, "fpga_c": 25.0}
        elif number == CENTROIDS:
            rows = [{k: s[k] for k in ("x_mm", "y_mm", "magnitude")} for s in self._stars(now_s)]
        elif number == MATCHES:
            names = ("star", "x_mm", "y_mm", "error_x", "error_y")
            rows = [{k: s[k] for k in names} for s in self._stars(now_s)]
        return stamp + encode(row.fields, values, {"items": rows}, LITTLE)

    def _solution(self, now_s: float) -> dict[str, Value]:
        quaternion, rate_rad_s = measured(self._world, now_s, SIGMA_ARCSEC)
        valid = float(np.linalg.norm(rate_rad_s)) <= FASTEST_RAD_S
        self._stable = self._stable + 1 if valid else 0
        x, y, z, w = (float(q) for q in quaternion)
        fields: dict[str, Value] = {
            f"{name}_{axis}": q
            for name in ("quaternion", "tracking", "lost")
            for axis, q in zip("wxyz", (w, x, y, z), strict=True)
        }
        count = len(self._stars(now_s))
        mode = "tracking" if self._stable > 1 else "lost_in_space"
        return fields | {
            "tracking_confidence": 1.0,
            "centroided": count,
            "matched": count,
            "mode": mode,
            "valid": "solved" if valid and count else "none",
            "stable_count": self._stable,
        }

    def _stars(self, now_s: float) -> list[dict[str, Value]]:
        """Return the brightest stars in the field, brightest first, in millimetres from the centre of the detector."""
        camera, stars = self._world.instrument.profile.camera, self._catalogue
        pixels: Array = camera.project(stars.icrs @ self._world.environment.motion.at(now_s).cam_from_icrs.T)
        inside = np.flatnonzero(camera.contains(pixels))[:ROWS]
        rng = np.random.default_rng(np.random.SeedSequence([self._world.seed, int(now_s * 1e3), 1]))
        centre = np.array([(camera.columns - 1) / 2, (camera.rows - 1) / 2])
        pitch_mm = self._world.instrument.profile.pitch_col_mm
        places = (pixels[inside] + SIGMA_PX * rng.normal(size=(len(inside), 2)) - centre) * pitch_mm
        return [
            {
                "x_mm": float(x),
                "y_mm": float(y),
                "magnitude": max(0, round(10 * float(stars.v_mag[k]))),
                "star": int(stars.hip[k]),
                "error_x": 0.0,
                "error_y": 0.0,
            }
            for k, (x, y) in zip(inside, places, strict=True)
        ]

    def advance(self, now_s: float) -> None:
        """Send the subscribed telemetry five times per second."""
        if not self._running or now_s < self._next_s:
            return
        self._next_s = now_s + SEND_S
        for number in self._set.get(SUBSCRIPTION, b""):
            if number:
                self._send(REPLY | ASYNCHRONOUS, number, self._telemetry(number, now_s))

    def next_frame(self, now_s: float) -> bytes | None:
        """Return the next frame to send, or None."""
        return self._out.popleft() if self._out else None

    def shut_down(self, now_s: float) -> None:
        """Do nothing: parameters last for one run."""


def _zero(kind: str) -> Value:
    return 0.0 if kind in ("f32", "f64") else 0

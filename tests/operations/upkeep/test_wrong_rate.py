"""Bytes that are not valid packets: at a wrong line rate, from another instrument, or noise."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gss.device.driver import open_driver
from gss.device.simulator.environment import Environment
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.other_makers import UnitWorld
from gss.device.simulator.sagitta import open_unit
from gss.domain.errors import LinkDown
from gss.instruments.registry import shipped_registry
from gss.operations.upkeep.status import Header
from gss.settings import Settings
from gss.wiring.build import build

RATE = 115_200
STEP_S = 0.05
BITS = 10


def received(data: bytes, sent_baud: int, read_baud: int) -> bytes:
    """Return the bytes that a receiver with one rate reads from a line (8N1) on which ``data`` are sent with another one.
    Like most serial ports, the receiver keeps a byte whose stop bit is wrong."""
    levels = [bit for byte in data for bit in (0, *(byte >> k & 1 for k in range(8)), 1)] + [1] * BITS
    out, at_s = bytearray(), 0.0

    def level(when_s: float) -> int:
        return levels[min(int(when_s * sent_baud), len(levels) - 1)]

    while at_s < len(levels) / sent_baud:
        if level(at_s):
            at_s += 1 / (16 * read_baud)  # a receiver samples the idle line 16 times per bit
            continue
        out.append(sum(level(at_s + (k + 1.5) / read_baud) << k for k in range(8)))
        at_s += (BITS - 0.5) / read_baud
    return bytes(out)


class SagittaLine:
    """Line with a simulated Sagitta that sends without requests. ``baud``: rate of the ground's port. Time of the unit is
    simulated: ``STEP_S`` per read."""

    url = "memory://sagitta"

    def __init__(self, baud: int) -> None:
        instrument = shipped_registry().get("sagitta")
        motion = Inertial.pointing(np.radians(84.0), np.radians(5.0), 0.3)
        world = UnitWorld(instrument, Environment(instrument.profile, motion), 1, frozenset({"booted"}))
        self._unit, self._baud, self._now_s, self._closed = open_unit(world), baud, 0.0, False
        session = open_driver(instrument)
        session.link_up(0.0)
        session.submit(session.encode("SET_SUBSCRIPTION", {"telemetry_1": 36}))
        self._unit.feed(session.poll(0.0)[0], 0.0)

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        del max_bytes
        if self._closed:
            raise LinkDown("closed")
        time.sleep(timeout_s)
        self._now_s += STEP_S
        self._unit.advance(self._now_s)
        sent = b""
        while (frame := self._unit.next_frame(self._now_s)) is not None:
            sent += frame
        return received(sent, RATE, self._baud) if sent else b""

    def write(self, data: bytes) -> None:
        self._unit.feed(received(data, self._baud, RATE), self._now_s)

    def close(self) -> None:
        self._closed = True


class NoiseLine(SagittaLine):
    """Line on which random bytes arrive, as from an input that is not connected."""

    def __init__(self) -> None:
        super().__init__(RATE)
        self._rng = np.random.default_rng(1)

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        super().read(max_bytes, timeout_s)
        return self._rng.bytes(64)


@pytest.fixture
def headers(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Iterator[Header]]:
    """Successive header contents of a server on the line of the test's parameter."""
    services = build(Settings(data=tmp_path, instrument="sagitta"), open_line=lambda url, baud: request.param())
    services.dispatcher.start()
    services.line.link.start()
    services.line.link.open_later("memory://sagitta")

    def poll() -> Iterator[Header]:
        limit_s = time.monotonic() + 60
        while time.monotonic() < limit_s:
            time.sleep(0.1)
            yield services.upkeep.status.header()

    yield poll()
    services.stop()


def test_the_resampled_line_is_right_at_the_right_rate_only() -> None:
    """At the same rate all bytes are received; at another rate they are different."""
    data = bytes(range(256))
    assert received(data, RATE, RATE) == data
    assert received(data, RATE, RATE // 2) != data


@pytest.mark.parametrize("headers", [lambda: SagittaLine(RATE)], indirect=True)
def test_at_the_right_rate_the_unit_is_identified(headers: Iterator[Header]) -> None:
    """The line of this test carries packets if both ends use the same rate."""
    assert next(h for h in headers if h.profile).rx.state == "up"


@pytest.mark.parametrize("headers", [lambda: SagittaLine(RATE // 2), NoiseLine], indirect=True)
def test_invalid_bytes_are_distinguished_from_silence(headers: Iterator[Header]) -> None:
    """At a wrong rate, or with noise, no unit is identified, and the alarm states that bytes arrive and what to check."""
    header = next(h for h in headers if any("Bytes arrive" in alarm.text for alarm in h.alarms))
    assert (header.connected, header.profile, header.rx.state, header.rx.frames) == (True, "", "down", 0)
    assert "check the line rate and the instrument" in header.alarms[0].text

"""A ground and a device on a line in memory, with simulated time: nothing waits, everything is real but the clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np
import pytest

from gss.device.dictionary import Dictionary, Value
from gss.device.dictionary_file import load_dictionary
from gss.device.golden import Golden, build_golden
from gss.device.protocol.codec import decode, encode
from gss.device.protocol.line import LineReceiver
from gss.device.protocol.packet import PacketType
from gss.device.session import HostSession
from gss.device.session_events import (
    CommandStage,
    DeviceEvent,
    SessionEvent,
    Stage,
    Telemetry,
    TransferDone,
    TransferUpdate,
)
from gss.device.session_transfer import Part
from gss.device.simulator.factory import burn_golden
from gss.device.simulator.faults import FaultRates, LineFaults
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.machine import Device, Identity
from gss.device.simulator.memory import Memory
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.sky import Sky
from gss.domain.profiles import profile

STEP_S = 0.01


@lru_cache(maxsize=8)
def golden(camera: str = "cubestar") -> Golden:
    return build_golden(profile(camera), Memory.in_ram().bank_bytes)


class Bench:
    """Host session and device joined by a line of a given rate; ``events`` collects what the host said."""

    def __init__(
        self,
        baud: int = 921_600,
        faults: FaultRates | None = None,
        dictionary: Dictionary | None = None,
        camera: str = "cubestar",
        identity: Identity | None = None,
        memory: Memory | None = None,
    ) -> None:
        self.dictionary = load_dictionary()
        self.baud, self.now_s = baud, 100.0
        self.memory = memory or Memory.in_ram()
        if memory is None:
            burn_golden(self.memory, profile(camera), golden(camera))
        motion = Inertial.pointing(np.radians(84.0), np.radians(5.0), 0.3)
        self.tracker = StarTracker(profile(camera), Sky(profile(camera), motion, 2026.0, 1), self.memory)
        unit = identity or Identity(line_baud=baud)
        self.device = Device(self.dictionary, unit, self.memory, self.tracker, self.now_s)
        self.host = HostSession(dictionary or self.dictionary)
        self.up_faults = LineFaults(faults or FaultRates(), 1)
        self.down_faults = LineFaults(faults or FaultRates(), 2)
        self.connected = True
        self.events: list[SessionEvent] = []
        self._up, self._down = bytearray(), bytearray()
        self._credit = 0.0
        self.host.link_up(self.now_s)

    def step(self) -> None:
        """One hundredth of a second."""
        self.now_s += STEP_S
        share = int(self.baud / 10 * STEP_S) or 1
        out, events = self.host.poll(self.now_s)
        self.events += events
        self._up += out
        going, self._up = bytes(self._up[:share]), self._up[share:]
        self.device.advance(self.now_s)
        if self.connected:
            self.device.feed(self.up_faults.apply(going), self.now_s)
        while len(self._down) < share:
            frame = self.device.next_frame(self.now_s)
            if frame is None:
                break
            self._down += frame
        coming, self._down = bytes(self._down[:share]), self._down[share:]
        if self.connected:
            self.events += self.host.feed(self.down_faults.apply(coming), self.now_s)

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds / STEP_S)):
            self.step()

    def until(self, done: Callable[[], bool], seconds: float = 30.0) -> None:
        """Let time pass until something holds; fails when it never does."""
        for _ in range(round(seconds / STEP_S)):
            if done():
                return
            self.step()
        pytest.fail(f"not reached within {seconds} s of simulated time")

    def stages(self, request_id: int) -> list[CommandStage]:
        """What was said about a command."""
        return [e for e in self.events if isinstance(e, CommandStage) and e.request_id == request_id]

    def stage(self, request_id: int) -> Stage:
        """Where a command is now."""
        said = self.stages(request_id)
        return said[-1].stage if said else Stage.QUEUED

    def do(self, name: str, seconds: float = 30.0, **arguments: float | str | bool) -> CommandStage:
        """Send a command and wait for its end."""
        request_id = self.host.submit(name, arguments, self.now_s)
        ends = (Stage.COMPLETED, Stage.FAILED, Stage.REJECTED, Stage.UNKNOWN)
        self.until(lambda: self.stage(request_id) in ends, seconds)
        return self.stages(request_id)[-1]

    def telemetry(self, packet: str) -> list[Telemetry]:
        """Packets of one name, in order."""
        return [e for e in self.events if isinstance(e, Telemetry) and e.packet == packet]

    def device_events(self, name: str) -> list[DeviceEvent]:
        """Events of one name, in order."""
        return [e for e in self.events if isinstance(e, DeviceEvent) and e.name == name]

    def status(self) -> Mapping[str, Value]:
        """Housekeeping now."""
        self.do("GET_STATUS")
        return self.telemetry("housekeeping")[-1].values

    def updates(self, transfer_id: int) -> list[TransferUpdate]:
        """What was said about a transfer."""
        return [e for e in self.events if isinstance(e, TransferUpdate) and e.transfer_id == transfer_id]

    def bring(self, kind: str, target: int, **part: int) -> bytes:
        """Download something whole."""
        wanted = Part(**part) if part else Part()
        transfer_id = self.host.start_download(kind, target, self.now_s, part=wanted)
        self.until(lambda: self.host.transfer(transfer_id).state in ("verified", "failed", "aborted"), 60.0)
        done = [e for e in self.events if isinstance(e, TransferDone) and e.transfer_id == transfer_id]
        assert done, self.host.transfer(transfer_id)
        return done[-1].data

    def refusal(self, service: str, values: Mapping[str, Value]) -> str:
        """Reason of the ABORT_TRANSFER that a message of the caller's own making brings."""
        row = self.dictionary.service(service)
        refused = self.dictionary.service("ABORT_TRANSFER")
        frame = self.host.craft(PacketType.TRANSFER, row.code, encode(row.fields, values))[1]
        self.device.feed(frame, self.now_s)
        receiver = LineReceiver(from_device=True)
        while (sent := self.device.next_frame(self.now_s)) is not None:
            for packet in receiver.feed(sent):
                if packet.type is PacketType.TRANSFER and packet.code == refused.code:
                    return str(decode(refused.fields, packet.payload).values["reason"])
        return "not refused"

    def transfer_ends(self, transfer_id: int, state: str, seconds: float = 60.0) -> TransferUpdate:
        """Wait for a state of a transfer."""
        self.until(lambda: any(u.state == state for u in self.updates(transfer_id)[-3:]), seconds)
        return self.host.transfer(transfer_id)


@pytest.fixture
def bench() -> Bench:
    """A fast faultless line, greeted."""
    made = Bench()
    made.until(lambda: made.host.hello is not None)
    return made


@pytest.fixture(scope="module")
def bench_unit() -> Bench:
    """One greeted unit for a whole file of things that may not change it."""
    made = Bench()
    made.until(lambda: made.host.hello is not None)
    return made


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    """Benches with other lines."""
    return Bench


@pytest.fixture
def golden_catalogue() -> Golden:
    """The factory catalogue of CubeStar."""
    return golden()

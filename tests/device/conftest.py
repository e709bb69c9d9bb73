"""Ground and device joined by a line in memory with simulated time, so that tests do not wait."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np
import pytest

from gss.device.protocol.authentication import LinkKeys, PacketSigner
from gss.device.protocol.codec import decode, encode
from gss.device.protocol.packet import PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.device.session import HostSession
from gss.device.session_events import (
    CommandUpdate,
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
from gss.device.simulator.machine import Identity, SimulatedDevice
from gss.device.simulator.memory import Memory
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.sky import SimulatedSky
from gss.instruments.dictionary.definitions import Dictionary, Value
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.golden import Golden, build_golden
from gss.instruments.package_files import TYPICAL, UnitTiming
from gss.instruments.registry import shipped_camera

STEP_S = 0.01


@lru_cache(maxsize=8)
def golden(camera: str = "cubestar") -> Golden:
    return build_golden(shipped_camera(camera), Memory.in_ram().bank_bytes)


class Bench:
    """Host session and device joined by a line with a given baud rate. ``events`` collects the host's events."""

    def __init__(
        self,
        baud: int = 921_600,
        faults: FaultRates | None = None,
        dictionary: Dictionary | None = None,
        camera: str = "cubestar",
        identity: Identity | None = None,
        memory: Memory | None = None,
        keys: LinkKeys | None = None,
        timing: UnitTiming = TYPICAL,
    ) -> None:
        self.dictionary = load_dictionary()
        self.baud, self.now_s = baud, 100.0
        self.memory = memory or Memory.in_ram()
        if memory is None:
            burn_golden(self.memory, shipped_camera(camera), golden(camera))
        motion = Inertial.pointing(np.radians(84.0), np.radians(5.0), 0.3)
        self.tracker = StarTracker(
            shipped_camera(camera), SimulatedSky(shipped_camera(camera), motion, 2026.0, 1), self.memory, timing
        )
        unit = identity or Identity(line_baud=baud)
        self.device = SimulatedDevice(
            self.dictionary, unit, self.memory, self.tracker, self.now_s, keys=keys, timing=timing
        )
        signer = PacketSigner(keys, itertools.count(1).__next__) if keys else None
        self.host = HostSession(dictionary or self.dictionary, signer=signer)
        self.up_faults = LineFaults(faults or FaultRates(), 1)
        self.down_faults = LineFaults(faults or FaultRates(), 2)
        self.connected = True
        self.events: list[SessionEvent] = []
        self._up, self._down = bytearray(), bytearray()
        self._credit = 0.0
        self.host.link_up(self.now_s)

    def step(self) -> None:
        """Advance time by 10 ms."""
        self.now_s += STEP_S
        share = int(self.baud / 10 * STEP_S) or 1
        out, events = self.host.poll(self.now_s)
        self.events += events
        self._up += out
        uplink_bytes, self._up = bytes(self._up[:share]), self._up[share:]
        self.device.advance(self.now_s)
        if self.connected:
            self.device.feed(self.up_faults.apply(uplink_bytes), self.now_s)
        while len(self._down) < share:
            frame = self.device.next_frame(self.now_s)
            if frame is None:
                break
            self._down += frame
        downlink_bytes, self._down = bytes(self._down[:share]), self._down[share:]
        if self.connected:
            self.events += self.host.feed(self.down_faults.apply(downlink_bytes), self.now_s)

    def run(self, seconds: float) -> None:
        """Advance time by ``seconds``."""
        for _ in range(round(seconds / STEP_S)):
            self.step()

    def until(self, done: Callable[[], bool], seconds: float = 30.0) -> None:
        """Advance time until ``done()`` is true; fails after ``seconds``."""
        for _ in range(round(seconds / STEP_S)):
            if done():
                return
            self.step()
        pytest.fail(f"not reached within {seconds} s of simulated time")

    def stages(self, request_id: int) -> list[CommandUpdate]:
        """Return the updates of a command received so far."""
        return [e for e in self.events if isinstance(e, CommandUpdate) and e.request_id == request_id]

    def stage(self, request_id: int) -> Stage:
        """Return the current stage of a command."""
        updates_so_far = self.stages(request_id)
        return updates_so_far[-1].stage if updates_so_far else Stage.QUEUED

    def do(self, name: str, seconds: float = 30.0, **arguments: float | str | bool) -> CommandUpdate:
        """Send a command, wait until it ends and return its last update."""
        request_id = self.host.submit(self.host.encode(name, arguments))
        ends = (Stage.COMPLETED, Stage.FAILED, Stage.REJECTED, Stage.UNKNOWN)
        self.until(lambda: self.stage(request_id) in ends, seconds)
        return self.stages(request_id)[-1]

    def telemetry(self, packet: str) -> list[Telemetry]:
        """Return the packets of one name, in order."""
        return [e for e in self.events if isinstance(e, Telemetry) and e.packet == packet]

    def device_events(self, name: str) -> list[DeviceEvent]:
        """Return the events of one name, in order."""
        return [e for e in self.events if isinstance(e, DeviceEvent) and e.name == name]

    def status(self) -> Mapping[str, Value]:
        """Return the current housekeeping values."""
        self.do("GET_STATUS")
        return self.telemetry("housekeeping")[-1].values

    def updates(self, transfer_id: int) -> list[TransferUpdate]:
        """Return the updates of a transfer so far."""
        return [e for e in self.events if isinstance(e, TransferUpdate) and e.transfer_id == transfer_id]

    def download(self, kind: str, target: int, **part: int) -> bytes:
        """Download a complete object."""
        requested_part = Part(**part) if part else Part()
        transfer_id = self.host.transfers.start_download(kind, target, part=requested_part)
        self.until(lambda: self.host.transfer(transfer_id).state in ("verified", "failed", "aborted"), 60.0)
        done = [e for e in self.events if isinstance(e, TransferDone) and e.transfer_id == transfer_id]
        assert done, self.host.transfer(transfer_id)
        return done[-1].data

    def refusal(self, service: str, values: Mapping[str, Value]) -> str:
        """Return the reason of the ABORT_TRANSFER that answers a message with these values."""
        row = self.dictionary.service(service)
        return self.refusal_of(row.code, encode(row.fields, values))

    def refusal_of(self, code: int, payload: bytes) -> str:
        """Return the reason of the ABORT_TRANSFER that answers a transfer message with any payload."""
        abort = self.dictionary.service("ABORT_TRANSFER")
        frame = self.host.craft(PacketType.TRANSFER, code, payload)[1]
        self.device.feed(frame, self.now_s)
        receiver = LineReceiver(from_device=True)
        while (sent := self.device.next_frame(self.now_s)) is not None:
            for packet in receiver.feed(sent):
                if packet.type is PacketType.TRANSFER and packet.code == abort.code:
                    return str(decode(abort.fields, packet.payload).values["reason"])
        return "not refused"

    def transfer_ends(self, transfer_id: int, state: str, seconds: float = 60.0) -> TransferUpdate:
        """Wait until a transfer has a state and return its last update."""
        self.until(lambda: any(u.state == state for u in self.updates(transfer_id)[-3:]), seconds)
        return self.host.transfer(transfer_id)


@pytest.fixture
def bench() -> Bench:
    """Bench with a fast line without faults, after HELLO."""
    ready_bench = Bench()
    ready_bench.until(lambda: ready_bench.host.hello is not None)
    return ready_bench


@pytest.fixture(scope="module")
def bench_unit() -> Bench:
    """Bench after HELLO, shared by all tests of a file. The tests must not change it."""
    ready_bench = Bench()
    ready_bench.until(lambda: ready_bench.host.hello is not None)
    return ready_bench


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    """Factory of benches with other parameters."""
    return Bench


@pytest.fixture
def golden_catalogue() -> Golden:
    """Factory catalogue of CubeStar."""
    return golden()

"""Simulated device at the level of the line: received bytes, frames to send, boots and housekeeping. No I/O.

``now_s`` in all methods is the simulated time. The device's clock counts from its first start and continues across
resets.
"""

from __future__ import annotations

from dataclasses import dataclass

from gss import __version__
from gss.device.protocol.authentication import LinkKeys, PacketVerifier
from gss.device.protocol.codec import decode, encode, fixed_bytes
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.device.simulator.bank_handlers import BankHandlers
from gss.device.simulator.command_processor import Arguments, CommandProcessor, Handler, Returns
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.housekeeping import Housekeeper
from gss.device.simulator.images import SLOTS
from gss.device.simulator.loader import Loader
from gss.device.simulator.memory import Memory
from gss.device.simulator.openings import CHUNK_RANGE
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.power import Power
from gss.device.simulator.reports import frame_report
from gss.device.simulator.schedule import Schedule
from gss.device.simulator.sessions import WINDOW_CHUNKS
from gss.device.simulator.setting_handlers import SettingHandlers
from gss.device.simulator.table_handlers import TableHandlers
from gss.device.simulator.tracker_handlers import TrackerHandlers
from gss.device.simulator.training import Training
from gss.device.simulator.unit_handlers import UnitHandlers
from gss.domain.errors import CorruptData
from gss.instruments.dictionary.definitions import Dictionary
from gss.instruments.package_files import TYPICAL, PowerRow, UnitTiming

LAST_WORDS_S = 0.2
MAX_OVERDUE = 30
"""Maximum number of housekeeping packets sent late after the simulator's process was suspended."""


@dataclass(frozen=True)
class Identity:
    """Values of HELLO that are not in profile or dictionary. ``line_baud`` 0: not paced."""

    serial: str = "SIM-0001"
    simulated: bool = True
    line_baud: int = 0


class SimulatedDevice:
    """A star tracker on a line. ``timing``, ``power``: from the instrument's simulator.yaml. ``training``: fault
    injection, also used by tests."""

    def __init__(
        self,
        dictionary: Dictionary,
        identity: Identity,
        memory: Memory,
        tracker: StarTracker,
        now_s: float,
        *,
        framing: str = "cobs",
        timing: UnitTiming = TYPICAL,
        power: Power | None = None,
        keys: LinkKeys | None = None,
    ) -> None:
        self._timing, self._housekeeping_s = timing, timing.housekeeping_s
        self._dictionary, self._identity, self._memory, self._tracker = dictionary, identity, memory, tracker
        self._now_s = now_s
        self._origin_s = now_s - memory.record.time_base_s
        self.clock = tracker.clock
        self.power = power or Power(PowerRow())
        self._verifier = PacketVerifier(keys, memory.record.accepted_counter) if keys else None
        self._receiver = LineReceiver(from_device=False, framing=framing, verifier=self._verifier)
        world = tracker.sky.environment
        self._outbox = Outbox(dictionary, lambda report: world.receive(report, self.sky_s), framing)
        self._loader = Loader(
            dictionary,
            memory,
            tracker,
            identity.line_baud / 10,
            lambda at_s: self.clock.at(at_s - self._origin_s),
            lambda: self.power.on("sram"),
        )
        self._processor = CommandProcessor(dictionary, memory, self._outbox, self.housekeeping, self._command_completed)
        self._add_handlers()
        self._boot("power_on", now_s)

    def _add_handlers(self) -> None:
        """Create the handlers by subject, all with the same tracker, memory and outbox."""
        tracker, memory, outbox, loader, processor = (
            self._tracker,
            self._memory,
            self._outbox,
            self._loader,
            self._processor,
        )
        self._tracker_handlers = TrackerHandlers(
            tracker, outbox, processor, self.power, lambda: (self._now_s, self.sky_s), self._timing.cycle_ms
        )
        self._banks = BankHandlers(memory, tracker, loader, outbox, self._timing)
        self._tables = TableHandlers(memory, tracker, loader, outbox, self._timing)
        self._schedule = Schedule(self._dictionary, memory, outbox, processor, lambda: self.time_s)
        self._unit = UnitHandlers(self.power, tracker, self._tracker_handlers, loader, memory, outbox, self._registers)
        settings = SettingHandlers(tracker, self._tracker_handlers, self.clock, outbox, lambda: self.sky_s)
        self.training = Training(
            tracker, memory, self.power, self.clock, outbox, lambda: self.sky_s, self._request_watchdog_reset
        )
        self._housekeeper = Housekeeper(
            tracker,
            memory,
            self.power,
            processor,
            self._receiver,
            loader,
            self._tracker_handlers,
            self._banks,
            self._schedule,
        )
        handler_groups = (self._tracker_handlers, self._banks, self._tables, self._schedule, self._unit, settings)
        processor.add_handlers(self._device_handlers(), self._tracker_handlers.guards())
        for group in handler_groups:
            processor.add_handlers(group.handlers())
        if self._identity.simulated:
            processor.add_handlers(self.training.handlers())

    # --- boot and time ------------------------------------------------------------------------------------------

    def _boot(self, cause: str, now_s: float) -> None:
        record = self._memory.record
        record.boots += 1
        record.resets += cause != "power_on"
        record.reset_cause = cause
        self._now_s = self._booted_s = now_s
        self._asleep_until_s = self._housekeeping_due_s = now_s + self._timing.boot_s
        self._reset: tuple[str, float] | None = None
        self._outbox.time_s = self.time_s
        if cause == "power_on":
            # The duration without power is unknown, so UTC is no longer valid.
            record.utc_offset_s = None
        self._loader.restart()
        self._receiver.restart()
        self._tracker_handlers.reset()
        self.power.restart()
        self._outbox.event("BOOT", f"{cause}, boot {record.boots}")
        self._processor.restart()
        self._tables.restart()
        self._banks.restart()
        for problem in self._tracker.tables.load():
            self._outbox.event("TABLE_CORRUPT", problem)
        self._booting = True
        self._memory.save()

    def reset(self, cause: str, now_s: float) -> None:
        """Restart the device; all content outside flash is lost."""
        self._now_s = max(now_s, self._now_s)
        self._memory.record.time_base_s = self.time_s
        self._outbox.clear()
        self._boot(cause, now_s)

    def shut_down(self, now_s: float) -> None:
        """Power off cleanly; at the next start the device's clock continues from this time."""
        self._now_s = max(now_s, self._now_s)
        self._memory.record.time_base_s = self.time_s
        self._memory.save()

    @property
    def sky_s(self) -> float:
        """Simulated time of the sky in seconds; equal to the device time while the device's clock has no fault."""
        return self._now_s - self._origin_s

    @property
    def time_s(self) -> float:
        """Time of the device's clock."""
        return self.clock.at(self.sky_s)

    def _command_completed(self, name: str) -> None:
        if name == "RESET":
            self._reset = ("command", self._now_s + LAST_WORDS_S)

    def _request_watchdog_reset(self) -> None:
        self._reset = ("watchdog", self._now_s + LAST_WORDS_S)

    # --- line ---------------------------------------------------------------------------------------------------

    def feed(self, data: bytes, now_s: float) -> None:
        """Process bytes from the ground; ignored while booting."""
        self.advance(now_s)
        if now_s < self._asleep_until_s:
            return
        packets = self._receiver.feed(data)
        if self._verifier is not None and any(p.type is PacketType.COMMAND for p in packets):
            # The counter is saved before the command runs, because after a restart its packet must not be accepted
            # again.
            self._memory.record.accepted_counter = self._verifier.accepted
            self._memory.save()
        for packet in packets:
            if packet.type is PacketType.COMMAND:
                self._processor.receive(packet, self._now_s)
            elif packet.type is PacketType.TRANSFER:
                self._transfer(packet)

    def next_frame(self, now_s: float) -> bytes | None:
        """Return the next frame to send: reports and telemetry first, then chunks."""
        if now_s < self._asleep_until_s:
            return None
        waiting = self._outbox.take()
        if waiting is not None:
            return waiting
        message = self._loader.next_chunk(now_s)
        return self._outbox.transfer_frame(message) if message else None

    def advance(self, now_s: float) -> None:
        """Advance the time: running command, cycle, bank trials, transfers, housekeeping."""
        self._send_overdue_housekeeping(now_s)
        self._now_s = max(now_s, self._now_s)
        self._outbox.time_s = self.time_s
        if now_s < self._asleep_until_s:
            return
        if self._booting:
            self._booting = False
            self._schedule.restart(self.clock.at(self._asleep_until_s - self._origin_s))
        if self._reset is not None and now_s >= self._reset[1]:
            self.reset(self._reset[0], now_s)
            return
        self.training.advance()
        if self.power.advance(self.sky_s):
            self._unit.apply()
        self._banks.advance(self._now_s)
        self._tables.advance(self._now_s)
        self._schedule.advance()
        self._processor.run(self._now_s)
        self._tracker_handlers.run_cycle()
        self._loader.step(self._now_s)
        self._flush_loader()
        if now_s >= self._housekeeping_due_s:
            self._housekeeping_due_s += self._housekeeping_s
            self._send_housekeeping(0)
            self._flush_loader()

    def _send_overdue_housekeeping(self, now_s: float) -> None:
        """Send the housekeeping of periods in which this process was suspended, each with its due time.

        The processor of a real unit is never suspended. Sends at most ``MAX_OVERDUE`` packets; older periods are
        skipped.
        """
        if now_s < self._asleep_until_s:
            return
        overdue = int(max(0.0, now_s - self._housekeeping_due_s) // self._housekeeping_s)
        self._housekeeping_due_s += self._housekeeping_s * max(0, overdue - MAX_OVERDUE)
        for _ in range(min(overdue, MAX_OVERDUE)):
            self._now_s = max(self._housekeeping_due_s, self._now_s)
            self._outbox.time_s = self.time_s
            self._send_housekeeping(0)
            self._housekeeping_due_s += self._housekeeping_s

    def _flush_loader(self) -> None:
        for name, text in self.power.pending_events:
            self._outbox.event(name, text)
        self.power.pending_events.clear()
        for message in self._loader.take_messages():
            self._outbox.transfer(message)
        for name, text in self._loader.pending_events:
            self._outbox.event(name, text)
        self._loader.pending_events.clear()

    def _transfer(self, packet: Packet) -> None:
        service = self._dictionary.service_of_code("transfer", packet.code)
        if service is None or packet.prefix != self._dictionary.prefix:
            return
        try:
            message = decode(service.fields, packet.payload)
        except CorruptData as error:
            if service.name in ("OPEN_UPLOAD", "OPEN_DOWNLOAD"):
                right_length = len(packet.payload) == fixed_bytes(service.fields)
                self._loader.reject(packet.request_id, "out_of_range" if right_length else "bad_length", str(error))
                self._flush_loader()
            return
        self._processor.note_id(packet.request_id)
        frames_before = self._tracker.slots.copy()
        self._loader.receive(service.name, packet.request_id, message, self._now_s)
        for slot, frame in self._tracker.slots.items():
            if frames_before.get(slot) is not frame:
                self._outbox.telemetry(frame_report(frame), packet.request_id)
        self._flush_loader()

    # --- commands of the device as a whole ----------------------------------------------------------------------

    def _device_handlers(self) -> dict[str, Handler]:
        return {
            "HELLO": self._hello,
            "GET_STATUS": self._get_status,
            "RESET": lambda _, __: {},
            "ABORT": self._abort,
        }

    def _hello(self, _: Arguments, __: int) -> Returns:
        profile = self._tracker.profile
        return {
            "device_model": self._dictionary.device_model,
            "profile": profile.name,
            "firmware": f"sim {__version__}"[:16],
            "serial": self._identity.serial,
            "simulated": self._identity.simulated,
            "dictionary_hash": self._dictionary.hash,
            "line_baud": self._identity.line_baud,
            "window_chunks": WINDOW_CHUNKS,
            "max_chunk_bytes": CHUNK_RANGE[1],
            "columns": profile.camera.columns,
            "rows": profile.camera.rows,
            "bits": profile.sensor.bits,
            "image_slots": SLOTS,
            "bank_bytes": self._memory.bank_bytes,
            "boot_count": self._memory.record.boots,
            "last_request_id": self._memory.record.last_request_id,
        }

    def _get_status(self, _: Arguments, request_id: int) -> Returns:
        self._send_housekeeping(request_id)
        return {}

    def _abort(self, _: Arguments, request_id: int) -> Returns:
        commands, cycle, transfers = (
            self._processor.abort_all(),
            self._tracker_handlers.restart(),
            self._loader.abort_all(),
        )
        text = f"{commands} commands, {transfers} transfers, cycle {'stopped' if cycle else 'was off'}"
        self._outbox.event("ABORTED", text, request_id)
        self._flush_loader()
        return {}

    # --- housekeeping -------------------------------------------------------------------------------------------

    def housekeeping(self) -> Returns:
        """Return all values of the housekeeping packet, raw for fields with a conversion."""
        faults = self.training.at_work if self._identity.simulated else 0
        return self._housekeeper.values(self.sky_s, self.time_s, self._now_s - self._booted_s) | {
            "utc_s": self.clock.utc_s(self.sky_s),
            "training_faults": faults,
        }

    def _send_housekeeping(self, request_id: int) -> None:
        self._outbox.telemetry(("housekeeping", self.housekeeping(), {}), request_id)

    def _registers(self) -> bytes:
        """Return settings and counters as the bytes of a housekeeping packet."""
        return encode(self._dictionary.packet("housekeeping").fields, self.housekeeping())

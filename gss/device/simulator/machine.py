"""The device as the line sees it: bytes in, frames out, boots, housekeeping. No input or output of its own.

Everything takes ``now_s`` of the simulated clock; the device's own clock counts from its first start and never goes back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss import __version__
from gss.device.dictionary import Dictionary
from gss.device.protocol.codec import decode
from gss.device.protocol.line import LineReceiver
from gss.device.protocol.packet import Packet, PacketType
from gss.device.simulator.bank_orders import BankOrders
from gss.device.simulator.command_desk import Arguments, CommandDesk, Handler, Returns
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.images import SLOTS
from gss.device.simulator.loader import CHUNK_RANGE, Loader
from gss.device.simulator.memory import Memory
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.reports import frame_report, pose_values, timing_values
from gss.device.simulator.sessions import WINDOW_CHUNKS
from gss.device.simulator.tracker_orders import TrackerOrders
from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import CorruptData

HOUSEKEEPING_S = 1.0
BOOT_S = 0.3
LAST_WORDS_S = 0.2
DAY_AND_NIGHT_S = 5700.0


@dataclass(frozen=True)
class Identity:
    """What HELLO says besides what the profile and the dictionary know. ``line_baud`` 0: not paced."""

    serial: str = "SIM-0001"
    simulated: bool = True
    line_baud: int = 0


class Device:
    """A star tracker on a line."""

    def __init__(
        self, dictionary: Dictionary, identity: Identity, memory: Memory, tracker: StarTracker, now_s: float
    ) -> None:
        self._dictionary, self._identity, self._memory, self._tracker = dictionary, identity, memory, tracker
        self._receiver = LineReceiver(from_device=False)
        self._outbox = Outbox(dictionary)
        self._loader = Loader(dictionary, memory, tracker, identity.line_baud / 10)
        self._desk = CommandDesk(dictionary, memory, self._outbox, self.housekeeping)
        self._orders = TrackerOrders(tracker, self._outbox, self._desk, lambda: (self._now_s, self.time_s))
        self._banks = BankOrders(memory, tracker, self._loader, self._outbox)
        self._desk.handlers = self._orders.handlers() | self._banks.handlers() | self._own_handlers()
        self._desk.on_completed = self._command_completed
        self._origin_s = self._loader.origin_s = now_s - memory.record.time_base_s
        self._boot("power_on", now_s)

    # --- boot and time ------------------------------------------------------------------------------------------

    def _boot(self, cause: str, now_s: float) -> None:
        record = self._memory.record
        record.boots += 1
        record.resets += cause != "power_on"
        record.reset_cause = cause
        self._now_s = self._booted_s = now_s
        self._asleep_until_s = self._housekeeping_due_s = now_s + BOOT_S
        self._reset_due_s: float | None = None
        self._outbox.time_s = self.time_s
        self._loader.restart()
        self._receiver.restart()
        self._orders.restart()
        self._outbox.event("BOOT", f"{cause}, boot {record.boots}")
        self._desk.restart()
        self._banks.restart()
        self._memory.save()

    def reset(self, cause: str, now_s: float) -> None:
        """Restart; what is not in flash is gone."""
        self._memory.record.time_base_s = now_s - self._origin_s
        self._outbox.clear()
        self._boot(cause, now_s)

    def shut_down(self, now_s: float) -> None:
        """Power off in good order: the device's clock goes on from here."""
        self._memory.record.time_base_s = now_s - self._origin_s
        self._memory.save()

    @property
    def time_s(self) -> float:
        """The device's clock."""
        return self._now_s - self._origin_s

    def _command_completed(self, name: str) -> None:
        if name == "RESET":
            self._reset_due_s = self._now_s + LAST_WORDS_S

    # --- line ---------------------------------------------------------------------------------------------------

    def feed(self, data: bytes, now_s: float) -> None:
        """Bytes from the ground. While booting the line is deaf."""
        self.advance(now_s)
        if now_s < self._asleep_until_s:
            return
        for packet in self._receiver.feed(data):
            if packet.type is PacketType.COMMAND:
                self._desk.receive(packet, self._now_s)
            elif packet.type is PacketType.TRANSFER:
                self._transfer(packet)

    def next_frame(self, now_s: float) -> bytes | None:
        """The next frame for the line: reports and telemetry first, then chunks."""
        if now_s < self._asleep_until_s:
            return None
        waiting = self._outbox.take()
        if waiting is not None:
            return waiting
        message = self._loader.next_chunk(now_s)
        return self._outbox.transfer_frame(message) if message else None

    def advance(self, now_s: float) -> None:
        """Let time pass: running command, cycle, trial of a bank, transfers, housekeeping."""
        self._now_s = max(now_s, self._now_s)
        self._outbox.time_s = self.time_s
        if now_s < self._asleep_until_s:
            return
        if self._reset_due_s is not None and now_s >= self._reset_due_s:
            self.reset("command", now_s)
            return
        self._banks.advance(self._now_s)
        self._desk.run(self._now_s)
        self._orders.run_cycle()
        self._loader.step(self._now_s)
        self._flush_loader()
        if now_s >= self._housekeeping_due_s:
            missed = np.ceil((now_s - self._housekeeping_due_s) / HOUSEKEEPING_S)
            self._housekeeping_due_s += HOUSEKEEPING_S * max(1.0, missed)
            self._send_housekeeping(0)

    def _flush_loader(self) -> None:
        for message in self._loader.take_messages():
            self._outbox.transfer(message)
        for name, text in self._loader.news:
            self._outbox.event(name, text)
        self._loader.news.clear()

    def _transfer(self, packet: Packet) -> None:
        service = self._dictionary.service_of_code("transfer", packet.code)
        if service is None or packet.prefix != self._dictionary.prefix:
            return
        try:
            message = decode(service.fields, packet.payload)
        except CorruptData:
            return
        self._desk.note_id(packet.request_id)
        frames_before = self._tracker.slots.copy()
        self._loader.receive(service.name, packet.request_id, message, self._now_s)
        for slot, frame in self._tracker.slots.items():
            if frames_before.get(slot) is not frame:
                self._outbox.telemetry(frame_report(frame), packet.request_id)
        self._flush_loader()

    # --- commands of the device as a whole ----------------------------------------------------------------------

    def _own_handlers(self) -> dict[str, Handler]:
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
        commands, cycle, transfers = self._desk.abort_all(), self._orders.restart(), self._loader.abort_all()
        text = f"{commands} commands, {transfers} transfers, cycle {'stopped' if cycle else 'was off'}"
        self._outbox.event("ABORTED", text, request_id)
        self._flush_loader()
        return {}

    # --- housekeeping -------------------------------------------------------------------------------------------

    def _send_housekeeping(self, request_id: int) -> None:
        self._outbox.telemetry(("housekeeping", self.housekeeping() | self._analogue(), {}), request_id)

    def housekeeping(self) -> Returns:
        """The packet's digital values."""
        return self._tracker_values() | self._unit_values() | pose_values(self._tracker.quaternion)

    def _tracker_values(self) -> Returns:
        t = self._tracker
        values: Returns = {
            "mode": t.mode,
            "tracking_state": t.mode if t.mode in ("tracking", "assisted") else "lost",
            "cycle_running": self._orders.cycle_running,
            "iteration": t.iteration,
            "attitude_age_s": self.time_s - t.attitude_time_s if t.attitude_time_s is not None else 0.0,
            "centroids_found": len(t.detection.centroids) if t.detection else 0,
            "regions_invalid": min(255, t.detection.invalid) if t.detection else 0,
            "stars_matched": t.matched,
            "match_confidence": 100.0 * t.matching.confidence if t.matching else 0.0,
            "sigma_cross_arcsec": t.sigma_rad[0] / ARCSEC_RAD,
            "sigma_roll_arcsec": t.sigma_rad[1] / ARCSEC_RAD,
            "rate_deg_s": float(np.degrees(t.rate_rad_s(self.time_s))),
            "exposure_ms": t.exposure_ms,
            "threshold_dn": t.threshold_dn,
            "min_pixels": t.min_pixels,
            "max_pixels": t.max_pixels,
            "background_dn": float(t.detection.black_dn) if t.detection else 0.0,
        }
        return values | timing_values(t.timing)

    def _unit_values(self) -> Returns:
        record = self._memory.record
        bank = record.banks[record.active]
        return {
            "last_frame": record.frames,
            "latchups": 0,
            "gain": 1,
            "period_ms": 1000,
            "imager_on": True,
            "fpga_on": True,
            "sram_on": True,
            "latched_rails": 0,
            "time_set": False,
            "utc_s": float("nan"),
            "scheduled": 0,
            "next_scheduled_s": float("nan"),
            "triplets_bank": "factory",
            "calibration_bank": "factory",
            "parameters_bank": "factory",
            "orbit_known": False,
            "training_faults": 0,
            "resets": record.resets,
            "reset_cause": record.reset_cause,
            "uptime_s": int(self._now_s - self._booted_s),
            "commands_accepted": self._desk.accepted & 0xFFFF,
            "commands_rejected": self._desk.rejected & 0xFFFF,
            "frames_good": self._receiver.good,
            "frames_bad": self._receiver.bad_total,
            "transfer_sessions": self._loader.open_sessions,
            "flash_used_bytes": self._memory.used_bytes,
            "active_bank": record.active,
            "active_valid": self._tracker.catalogue is not None,
            "catalogue_stars": bank.stars,
            "catalogue_pairs": bank.pairs,
            "catalogue_sha256": bytes.fromhex(bank.sha256) if bank.sha256 else bytes(32),
            "confirm_left_s": self._banks.confirm_left_s,
        }

    def _analogue(self) -> Returns:
        """Raw converter values of a healthy unit; a slow swing stands in for the orbit's day and night."""
        swing = float(np.sin(2 * np.pi * self.time_s / DAY_AND_NIGHT_S))
        busy = self._orders.cycle_running or self._desk.busy
        return {
            "sensor_temperature_c": round((12.0 + 6.0 * swing + 50.0) / 0.0625),
            "processor_temperature_c": round(1650 + 90 * swing + 40 * busy),
            "supply_3v3_v": 3302 - 8 * busy,
            "current_processor_ma": 285 + 130 * busy,
            "current_imager_ma": 20 + 520 * busy,
            "current_fpga_ma": 30 + 180 * busy,
            "current_sram_ma": 40 + 60 * busy,
        }

"""The device as the line sees it: bytes in, packets out, command life, housekeeping, cycle, resets. No input or output.

Everything takes ``now_s`` of the simulated clock. One command runs at a time; those that take device time are generators
that yield how long to wait.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass

import numpy as np

from gss import __version__
from gss.device.dictionary import Command, Dictionary, Value
from gss.device.protocol.codec import Decoded, check_arguments, decode, encode
from gss.device.protocol.line import LineReceiver, LineSender
from gss.device.protocol.packet import Packet, PacketType
from gss.device.simulator.firmware import (
    SLOTS,
    STANDBY,
    Refusal,
    Report,
    StarTracker,
    pose_values,
    timing_values,
    truth_report,
)
from gss.device.simulator.loader import CHUNK_RANGE, WINDOW_CHUNKS, Loader, Outgoing
from gss.device.simulator.memory import BANKS, GOLDEN, Memory, StoredRequest
from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import BadInput, CorruptData

HOUSEKEEPING_S = 1.0
CYCLE_S = 1.0
CYCLE_SLOTS = (2, 3)
MOST_WAITING = 4
BOOT_S = 0.3
LAST_WORDS_S = 0.2
FLASH_READ_BYTES_S = 400_000.0
MOST_OUTGOING = 400
REPLAYED_AT = 3
"""Offset of the flag "replayed" in a report: after stage, reason and progress."""

Returns = dict[str, Value]
Task = Generator[float, None, Returns]
Handler = Callable[[Mapping[str, Value]], "Returns | Task"]


@dataclass(frozen=True)
class Identity:
    """What HELLO says besides what the profile and the dictionary know. ``line_baud`` 0: not paced."""

    serial: str = "SIM-0001"
    simulated: bool = True
    line_baud: int = 0


@dataclass
class Running:
    """A command that was accepted and has not ended."""

    request_id: int
    command: Command
    arguments: Mapping[str, Value]
    task: Task | None = None
    due_s: float = 0.0


class Device:
    """A star tracker on a line."""

    def __init__(
        self, dictionary: Dictionary, identity: Identity, memory: Memory, tracker: StarTracker, now_s: float
    ) -> None:
        self._dictionary, self._identity, self._memory, self._tracker = dictionary, identity, memory, tracker
        self._sender = LineSender(to_device=False, prefix=dictionary.prefix)
        self._receiver = LineReceiver(from_device=False)
        self._loader = Loader(dictionary, memory, tracker, identity.line_baud / 10)
        self._handlers: dict[str, Handler] = {
            name: getattr(self, "_do_" + name.lower()) for name in (c.name for c in dictionary.commands)
        }
        self._out: deque[bytes] = deque()
        self._origin_s = now_s - memory.record.time_base_s
        self._loader.origin_s = self._origin_s
        self._boot("power_on", now_s)

    # --- boot and time ------------------------------------------------------------------------------------------

    def _boot(self, cause: str, now_s: float) -> None:
        record = self._memory.record
        record.boots += 1
        record.resets += cause != "power_on"
        record.reset_cause = cause
        self._booted_s = now_s
        self._asleep_until_s = now_s + BOOT_S
        self._now_s = now_s
        self._current: Running | None = None
        self._waiting: deque[Running] = deque()
        self._cycle_due_s: float | None = None
        self._cycle_slot: int | None = None
        self._housekeeping_due_s = now_s + BOOT_S
        self._confirm_by_s: float | None = None
        self._reset_due_s: float | None = None
        self._accepted = self._rejected = 0
        self._loader.restart()
        self._receiver.restart()
        self._event("BOOT", f"{cause}, boot {record.boots}")
        self._settle_interrupted()
        if record.unconfirmed:
            lost, kept = record.active, self._memory.fall_back()
            self._event("BANK_FELL_BACK", f"bank {lost} was not confirmed before the reset; {kept} is active")
        self._tracker.restart()
        self._check_catalogue()
        self._memory.save()

    def _settle_interrupted(self) -> None:
        """What was running when the power went has failed, and says so when asked again."""
        for request in list(self._memory.record.requests):
            stage = bytes.fromhex(request.report)[:1]
            if stage in (b"\1", b"\3", b"\4"):
                self._report_raw(request, "failed", "reset", "the device restarted while the command ran")

    def _check_catalogue(self) -> None:
        problem = self._tracker.load_catalogue()
        if problem:
            self._event("BANK_CORRUPT", problem)

    def reset(self, cause: str, now_s: float) -> None:
        """Restart; what is not in flash is gone."""
        self._memory.record.time_base_s = now_s - self._origin_s
        self._out.clear()
        self._boot(cause, now_s)

    def shut_down(self, now_s: float) -> None:
        """Power off in good order: the device's clock goes on from here."""
        self._memory.record.time_base_s = now_s - self._origin_s
        self._memory.save()

    @property
    def time_s(self) -> float:
        """The device's clock."""
        return self._now_s - self._origin_s

    # --- line ---------------------------------------------------------------------------------------------------

    def feed(self, data: bytes, now_s: float) -> None:
        """Bytes from the ground. While booting the line is deaf."""
        self.advance(now_s)
        if now_s < self._asleep_until_s:
            return
        for packet in self._receiver.feed(data):
            if packet.type is PacketType.COMMAND:
                self._command(packet)
            elif packet.type is PacketType.TRANSFER:
                self._transfer(packet)

    def next_frame(self, now_s: float) -> bytes | None:
        """The next frame for the line: reports and telemetry first, then chunks."""
        if now_s < self._asleep_until_s:
            return None
        if self._out:
            return self._out.popleft()
        message = self._loader.next_chunk(now_s)
        return self._transfer_frame(message) if message else None

    def advance(self, now_s: float) -> None:
        """Let time pass: running command, cycle, confirmations, transfers, housekeeping."""
        self._now_s = max(now_s, self._now_s)
        if now_s < self._asleep_until_s:
            return
        if self._reset_due_s is not None and now_s >= self._reset_due_s:
            self.reset("command", now_s)
            return
        self._run()
        self._run_cycle()
        if self._confirm_by_s is not None and now_s >= self._confirm_by_s:
            self._not_confirmed()
        self._loader.step(now_s)
        self._flush_loader()
        if now_s >= self._housekeeping_due_s:
            self._housekeeping_due_s += HOUSEKEEPING_S * max(
                1.0, np.ceil((now_s - self._housekeeping_due_s) / HOUSEKEEPING_S)
            )
            self._send_housekeeping(0)

    def _flush_loader(self) -> None:
        for message in self._loader.take_messages():
            self._out.append(self._transfer_frame(message))
        for name, text in self._loader.news:
            self._event(name, text)
        self._loader.news.clear()

    def _transfer_frame(self, message: Outgoing) -> bytes:
        service = self._dictionary.service(message.service)
        payload = encode(service.fields, message.values, message.lists)
        return self._sender.packet(PacketType.TRANSFER, service.code, message.request_id, payload, self.time_s)

    def _transfer(self, packet: Packet) -> None:
        service = self._dictionary.service_of_code("transfer", packet.code)
        if service is None or packet.prefix != self._dictionary.prefix:
            return
        try:
            message: Decoded = decode(service.fields, packet.payload)
        except CorruptData:
            return
        self._note_id(packet.request_id)
        frames_before = self._tracker.slots.copy()
        self._loader.receive(service.name, packet.request_id, message, self._now_s)
        for slot, frame in self._tracker.slots.items():
            if frames_before.get(slot) is not frame:
                self._telemetry(self._tracker.frame_report(frame), packet.request_id)
        self._flush_loader()

    def _telemetry(self, report: Report, request_id: int) -> None:
        name, values, lists = report
        packet = self._dictionary.packet(name)
        payload = encode(packet.fields, values, lists)
        self._push(self._sender.packet(PacketType.TELEMETRY, packet.code, request_id, payload, self.time_s))

    def _push(self, frame: bytes) -> None:
        """A line nobody drains must not fill the memory: the oldest goes."""
        self._out.append(frame)
        if len(self._out) > MOST_OUTGOING:
            self._out.popleft()

    def _event(self, name: str, text: str, request_id: int = 0) -> None:
        event = self._dictionary.event_named(name)
        payload = encode(self._dictionary.service("EVENT").fields, {"text": text[:200]})
        self._push(self._sender.packet(PacketType.EVENT, event.code, request_id, payload, self.time_s))

    # --- commands -----------------------------------------------------------------------------------------------

    def _command(self, packet: Packet) -> None:
        digest = hashlib.sha256(bytes([packet.code]) + packet.payload).hexdigest()
        known = self._memory.request(packet.request_id)
        command = self._dictionary.command_of_code(packet.code)
        # HELLO and ABORT must work for a ground that knows nothing of earlier ids.
        if known is not None and not (command and command.any_dictionary):
            self._repeat(known, packet, digest)
            return
        request = StoredRequest(packet.request_id, packet.code, digest, "")
        try:
            arguments = self._admit(command, packet)
        except Refusal as refusal:
            self._rejected += 1
            self._report_raw(request, "rejected", refusal.reason, refusal.detail)
            return
        assert command is not None  # noqa: S101 - _admit refuses unknown codes
        self._accepted += 1
        self._report_raw(request, "accepted")
        running = Running(packet.request_id, command, arguments)
        if command.name == "ABORT":
            self._start(running)
        else:
            self._waiting.append(running)
            self._run()

    def _repeat(self, known: StoredRequest, packet: Packet, digest: str) -> None:
        """The same id again: the stored report, marked; or a refusal where the content is another."""
        if known.digest != digest:
            self._rejected += 1
            payload = self._report_payload("rejected", "id_reused", "this id was used before")
            self._send_report(packet.request_id, packet.code, payload)
            return
        stored = bytearray.fromhex(known.report)
        stored[REPLAYED_AT] = 1
        self._send_report(packet.request_id, packet.code, bytes(stored))

    def _admit(self, command: Command | None, packet: Packet) -> Mapping[str, Value]:
        """All checks before a command is accepted."""
        if command is None:
            raise Refusal("unknown_command", f"code {packet.code}")
        if packet.prefix != self._dictionary.prefix and not command.any_dictionary:
            raise Refusal("wrong_dictionary", f"device {self._dictionary.prefix:04x}, ground {packet.prefix:04x}")
        try:
            values = decode(command.arguments, packet.payload).values
        except CorruptData as error:
            raise Refusal("bad_length", str(error)) from error
        try:
            arguments = check_arguments(command, values)
        except BadInput as error:
            raise Refusal("out_of_range", error.message) from error
        state = self.housekeeping()
        for condition in command.preconditions:
            if condition.met(state) is False:
                raise Refusal("wrong_state", f"not met: {condition.text}")
        if len(self._waiting) >= MOST_WAITING:
            raise Refusal("busy", f"{MOST_WAITING} commands are waiting")
        return arguments

    def _report_payload(self, stage: str, reason: str = "none", detail: str = "", returned: bytes = b"") -> bytes:
        fields = self._dictionary.service("REPORT").fields
        values: Returns = {"stage": stage, "reason": reason, "progress": 100 if stage == "completed" else 0}
        values |= {"replayed": False, "detail": detail.encode()[:200].decode(errors="ignore")}
        return encode(fields, values) + returned

    def _progress(self, percent: int) -> None:
        """A word on the way; not stored, a retry gets what comes after it."""
        if self._current is not None:
            fields = self._dictionary.service("REPORT").fields
            values: Returns = {
                "stage": "progress",
                "reason": "none",
                "progress": percent,
                "replayed": False,
                "detail": "",
            }
            self._send_report(self._current.request_id, self._current.command.code, encode(fields, values))

    def _report_raw(
        self, request: StoredRequest, stage: str, reason: str = "none", detail: str = "", returned: bytes = b""
    ) -> None:
        payload = self._report_payload(stage, reason, detail, returned)
        command = self._dictionary.command_of_code(request.code)
        if command is None or not command.any_dictionary:
            self._note_id(request.request_id)
            self._memory.remember(StoredRequest(request.request_id, request.code, request.digest, payload.hex()))
        if stage not in ("accepted", "started"):
            self._memory.save()
        self._send_report(request.request_id, request.code, payload)

    def _note_id(self, request_id: int) -> None:
        record = self._memory.record
        record.last_request_id = max(record.last_request_id, request_id)

    def _send_report(self, request_id: int, code: int, payload: bytes) -> None:
        self._push(self._sender.packet(PacketType.REPORT, code, request_id, payload, self.time_s))

    def _run(self) -> None:
        """Go on with the running command and start those that wait."""
        while True:
            if self._current is None:
                if not self._waiting:
                    return
                self._start(self._waiting.popleft())
                continue
            if self._now_s < self._current.due_s:
                return
            self._continue(self._current)

    def _start(self, running: Running) -> None:
        self._stage(running, "started")
        try:
            made = self._handlers[running.command.name](running.arguments)
        except Refusal as refusal:
            self._stage(running, "failed", refusal.reason, refusal.detail)
            return
        if isinstance(made, Generator):
            running.task, running.due_s = made, self._now_s
            self._current = running
        else:
            self._complete(running, made)

    def _continue(self, running: Running) -> None:
        assert running.task is not None  # noqa: S101 - only tasks become current
        self._request_id = running.request_id
        try:
            running.due_s = self._now_s + next(running.task)
        except StopIteration as stop:
            self._current = None
            self._complete(running, stop.value)
        except Refusal as refusal:
            self._current = None
            self._stage(running, "failed", refusal.reason, refusal.detail)

    _request_id = 0

    def _complete(self, running: Running, values: Returns) -> None:
        self._stage(running, "completed", returned=encode(running.command.returns, values))
        if running.command.name == "RESET":
            self._reset_due_s = self._now_s + LAST_WORDS_S

    def _stage(
        self, running: Running, stage: str, reason: str = "none", detail: str = "", returned: bytes = b""
    ) -> None:
        self._request_id = running.request_id
        request = self._memory.request(running.request_id)
        if request is None:
            request = StoredRequest(running.request_id, running.command.code, "", "")
        self._report_raw(request, stage, reason, detail, returned)

    # --- cycle --------------------------------------------------------------------------------------------------

    def _run_cycle(self) -> None:
        """Each second: work on the image before while the next one is taken (Erlank 2013 §5.3.6)."""
        if self._cycle_due_s is None or self._now_s < self._cycle_due_s:
            return
        start_s = self._cycle_due_s
        self._cycle_due_s += CYCLE_S * max(1.0, np.ceil((self._now_s - start_s) / CYCLE_S))
        previous = self._cycle_slot
        if previous is not None:
            self._iterate(previous, 0)
        slot = CYCLE_SLOTS[0] if previous != CYCLE_SLOTS[0] else CYCLE_SLOTS[1]
        frame = self._tracker.capture(slot, min(self._tracker.exposure_ms, 500), start_s - self._origin_s)
        self._telemetry(self._tracker.frame_report(frame), 0)
        self._cycle_slot = slot

    def _iterate(self, slot: int, request_id: int) -> None:
        tracker = self._tracker
        mode, had = tracker.mode, tracker.solution is not None and tracker.solution.attitude is not None
        readable = tracker.catalogue is not None
        for report in tracker.process(slot):
            self._telemetry(report, request_id)
        if readable and tracker.catalogue is None:
            self._event("BANK_CORRUPT", tracker.catalogue_problem, request_id)
        self._tell_mode(mode, request_id)
        if had and (tracker.solution is None or tracker.solution.attitude is None):
            self._event("ATTITUDE_LOST", f"frame {tracker.frame_number}", request_id)

    def _tell_mode(self, before: str, request_id: int) -> None:
        if self._tracker.mode != before:
            self._event("MODE_CHANGED", f"{before} to {self._tracker.mode}", request_id)

    # --- housekeeping -------------------------------------------------------------------------------------------

    def _send_housekeeping(self, request_id: int) -> None:
        self._telemetry(("housekeeping", self.housekeeping(raw=True), {}), request_id)

    def housekeeping(self, *, raw: bool = False) -> dict[str, Value]:
        """The packet's values; ``raw``: as the analogue converter has them, for sending."""
        t, record, bank = self._tracker, self._memory.record, self._memory.record.banks[self._memory.record.active]
        left_s = self._confirm_by_s - self._now_s if self._confirm_by_s is not None else 0.0
        values: dict[str, Value] = {
            "mode": t.mode,
            "tracking_state": {"tracking": "tracking", "assisted": "assisted"}.get(t.mode, "lost"),
            "cycle_running": self._cycle_due_s is not None,
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
            "last_frame": record.frames,
            "latchups": 0,
            "resets": record.resets,
            "reset_cause": record.reset_cause,
            "uptime_s": int(self._now_s - self._booted_s),
            "commands_accepted": self._accepted & 0xFFFF,
            "commands_rejected": self._rejected & 0xFFFF,
            "frames_good": self._receiver.good,
            "frames_bad": self._receiver.bad_total,
            "transfer_sessions": self._loader.open_sessions,
            "flash_used_bytes": self._memory.used_bytes,
            "active_bank": record.active,
            "active_valid": t.catalogue is not None,
            "catalogue_stars": bank.stars,
            "catalogue_pairs": bank.pairs,
            "catalogue_sha256": bytes.fromhex(bank.sha256) if bank.sha256 else bytes(32),
            "confirm_left_s": max(0, int(np.ceil(left_s))),
        }
        return values | pose_values(t.quaternion) | timing_values(t.timing) | (self._analogue() if raw else {})

    def _analogue(self) -> dict[str, Value]:
        """Raw converter values of a healthy unit; a slow swing stands in for the orbit's day and night."""
        swing = float(np.sin(2 * np.pi * self.time_s / 5700.0))
        busy = self._cycle_due_s is not None or self._current is not None
        return {
            "sensor_temperature_c": round((12.0 + 6.0 * swing + 50.0) / 0.0625),
            "processor_temperature_c": round(1650 + 90 * swing + 40 * busy),
            "supply_3v3_v": 3302 - 8 * busy,
            "current_processor_ma": 285 + 130 * busy,
            "current_imager_ma": 20 + 520 * busy,
            "current_fpga_ma": 30 + 180 * busy,
        }

    # --- what each command does ---------------------------------------------------------------------------------

    def _do_hello(self, _: Mapping[str, Value]) -> Returns:
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

    def _do_get_status(self, _: Mapping[str, Value]) -> Returns:
        self._send_housekeeping(self._request_id)
        return {}

    def _do_reset(self, _: Mapping[str, Value]) -> Returns:
        return {}

    def _do_abort(self, _: Mapping[str, Value]) -> Returns:
        stopped = [r for r in (self._current, *self._waiting) if r is not None]
        self._current = None
        self._waiting.clear()
        for running in stopped:
            self._stage(running, "failed", "aborted", "stopped by ABORT")
        cycle, self._cycle_due_s, self._cycle_slot = self._cycle_due_s is not None, None, None
        transfers = self._loader.abort_all()
        self._event(
            "ABORTED", f"{len(stopped)} commands, {transfers} transfers, cycle {'stopped' if cycle else 'was off'}"
        )
        self._flush_loader()
        return {}

    def _do_set_mode(self, a: Mapping[str, Value]) -> Returns:
        tracker, mode = self._tracker, str(a["mode"])
        if mode == "tracking" and tracker.quaternion is None:
            raise Refusal("wrong_state", "tracking needs an attitude: run an iteration or give a hint first")
        if mode == "assisted" and tracker.hint is None and tracker.quaternion is None:
            raise Refusal("wrong_state", "assisted needs SET_ATTITUDE_HINT first")
        before, tracker.mode = tracker.mode, mode
        if mode == STANDBY and self._cycle_due_s is not None:
            self._stop_cycle()
        self._tell_mode(before, self._request_id)
        return {}

    def _do_start_cycle(self, _: Mapping[str, Value]) -> Returns:
        if self._cycle_due_s is None:
            self._cycle_due_s, self._cycle_slot = self._now_s, None
            self._event("CYCLE_STARTED", "", self._request_id)
        return {}

    def _do_stop_cycle(self, _: Mapping[str, Value]) -> Returns:
        if self._cycle_due_s is not None:
            self._stop_cycle()
        return {}

    def _stop_cycle(self) -> None:
        self._cycle_due_s = self._cycle_slot = None
        self._event("CYCLE_STOPPED", f"after iteration {self._tracker.iteration}", self._request_id)

    def _expose(self, slot: int, exposure_ms: int) -> Task:
        tracker, request_id = self._tracker, self._request_id
        frame = tracker.capture(slot, exposure_ms, self.time_s)
        yield (tracker.timing.capture_ms + tracker.timing.transfer_ms) / 1000
        self._telemetry(tracker.frame_report(frame), request_id)
        return {"frame_number": frame.number, "slot": slot}

    def _do_take_image(self, a: Mapping[str, Value]) -> Task:
        return self._expose_with_truth(int(a["slot"]), int(a["exposure_ms"]) or self._tracker.exposure_ms)

    def _expose_with_truth(self, slot: int, exposure_ms: int) -> Task:
        request_id = self._request_id
        taken = yield from self._expose(slot, exposure_ms)
        frame = self._tracker.stored(slot)
        if frame.truth is not None:
            self._telemetry(truth_report(frame.number, frame.truth), request_id)
        return taken

    def _do_run_iteration(self, a: Mapping[str, Value]) -> Task:
        tracker, request_id, slot = self._tracker, self._request_id, int(a["slot"])
        taken = yield from self._expose(slot, tracker.exposure_ms)
        self._progress(60)
        self._iterate(slot, request_id)
        t = tracker.timing
        yield (t.detect_ms + t.match_ms + t.attitude_ms) / 1000
        solved = tracker.solution is not None and tracker.solution.attitude is not None
        return {"frame_number": taken["frame_number"], "outcome": "solved" if solved else "none"}

    def _do_list_frames(self, _: Mapping[str, Value]) -> Returns:
        frames = sorted(self._tracker.slots.items())
        for _slot, frame in frames:
            self._telemetry(self._tracker.frame_report(frame), self._request_id)
        return {"count": len(frames)}

    def _do_set_exposure(self, a: Mapping[str, Value]) -> Returns:
        self._tracker.exposure_ms = int(a["exposure_ms"])
        return {}

    def _do_set_detection(self, a: Mapping[str, Value]) -> Returns:
        low, high = int(a["min_pixels"]), int(a["max_pixels"])
        if low > high:
            raise Refusal("out_of_range", f"smallest region {low} is above the largest {high}")
        self._tracker.threshold_dn, self._tracker.min_pixels, self._tracker.max_pixels = (
            int(a["threshold_dn"]),
            low,
            high,
        )
        return {}

    def _do_set_attitude_hint(self, a: Mapping[str, Value]) -> Returns:
        ra, dec, roll, radius = (
            float(np.radians(float(a[n]))) for n in ("ra_deg", "dec_deg", "roll_deg", "uncertainty_deg")
        )
        self._tracker.set_hint(ra, dec, roll, radius)
        return {}

    def _do_find_centroids(self, a: Mapping[str, Value]) -> Task:
        tracker, request_id = self._tracker, self._request_id
        detection = tracker.find_centroids(int(a["slot"]))
        yield tracker.timing.detect_ms / 1000
        self._telemetry(tracker.centroid_report(), request_id)
        return {
            "frame_number": tracker.frame_number,
            "centroids": min(255, len(detection.centroids)),
            "regions_invalid": min(255, detection.invalid),
        }

    def _do_match_stars(self, _: Mapping[str, Value]) -> Task:
        tracker, request_id = self._tracker, self._request_id
        if tracker.load_catalogue():
            self._event("BANK_CORRUPT", tracker.catalogue_problem, request_id)
        matching = tracker.match_stars()
        yield tracker.timing.match_ms / 1000
        self._telemetry(tracker.match_report(), request_id)
        if matching.reason:
            raise Refusal("too_few_stars" if len(matching.row) < 3 else "no_match", matching.reason)
        return {"frame_number": tracker.frame_number, "matched": tracker.matched}

    def _do_calculate_attitude(self, _: Mapping[str, Value]) -> Task:
        tracker, request_id, mode = self._tracker, self._request_id, self._tracker.mode
        solution = tracker.calculate_attitude()
        yield tracker.timing.attitude_ms / 1000
        self._telemetry(tracker.attitude_report(), request_id)
        self._tell_mode(mode, request_id)
        return {"frame_number": tracker.frame_number, "outcome": "solved" if solution.attitude else "none"}

    # --- banks --------------------------------------------------------------------------------------------------

    def _bank_report(self, bank: str) -> Report:
        held, record = self._memory.record.banks[bank], self._memory.record
        values: Returns = {
            "bank": bank,
            "state": held.state,
            "active": record.active == bank,
            "write_protected": bank == GOLDEN,
            "size_bytes": held.size,
            "capacity_bytes": self._memory.bank_bytes,
            "stars": held.stars,
            "pairs": held.pairs,
            "epoch_jyear": held.epoch_jyear,
            "format_version": held.format_version,
            "profile": held.profile,
            "sha256": bytes.fromhex(held.sha256) if held.sha256 else bytes(32),
        }
        return "bank_info", values, {}

    def _do_list_banks(self, _: Mapping[str, Value]) -> Returns:
        for bank in BANKS:
            self._telemetry(self._bank_report(bank), self._request_id)
        return {"count": len(BANKS)}

    def _read_back(self, bank: str) -> Generator[float, None, str]:
        """SHA-256 of what is in flash now; a bank that is not what its record says becomes corrupt."""
        held = self._memory.record.banks[bank]
        if held.state not in ("committed", "corrupt"):
            raise Refusal("bank_empty", f"bank {bank} is {held.state}")
        yield held.size / FLASH_READ_BYTES_S
        digest = self._memory.hash_of(bank)
        state = "committed" if digest == held.sha256 else "corrupt"
        if state != held.state:
            self._memory.set_state(bank, state)
        if state == "corrupt":
            self._event(
                "BANK_CORRUPT", f"bank {bank} reads {digest[:12]}, should be {held.sha256[:12]}", self._request_id
            )
            if bank == self._memory.record.active:
                self._tracker.load_catalogue()
        return digest

    def _do_verify_bank(self, a: Mapping[str, Value]) -> Task:
        bank, request_id = str(a["bank"]), self._request_id
        digest = yield from self._read_back(bank)
        self._telemetry(self._bank_report(bank), request_id)
        if self._memory.record.banks[bank].state == "corrupt":
            raise Refusal("bank_corrupt", f"bank {bank} does not match its checksum")
        return {"sha256": bytes.fromhex(digest)}

    def _do_activate_bank(self, a: Mapping[str, Value]) -> Task:
        bank, request_id, record = str(a["bank"]), self._request_id, self._memory.record
        if bank == record.active:
            raise Refusal("bank_active", f"bank {bank} is active already")
        if record.unconfirmed:
            raise Refusal("wrong_state", f"bank {record.active} waits for CONFIRM_BANK")
        yield from self._read_back(bank)
        if record.banks[bank].state == "corrupt":
            raise Refusal("bank_corrupt", f"bank {bank} does not match its checksum")
        if record.banks[bank].profile != self._tracker.profile.name:
            raise Refusal("incompatible", f"bank {bank} is for {record.banks[bank].profile}")
        self._memory.activate(bank)
        self._confirm_by_s = self._now_s + int(a["confirm_within_s"])
        self._tracker.load_catalogue()
        self._event("BANK_ACTIVATED", f"bank {bank}; confirm within {int(a['confirm_within_s'])} s", request_id)
        self._telemetry(self._bank_report(bank), request_id)
        return {}

    def _do_confirm_bank(self, a: Mapping[str, Value]) -> Returns:
        record = self._memory.record
        if a["bank"] != record.active:
            raise Refusal("wrong_state", f"bank {record.active} is active")
        if record.unconfirmed:
            self._memory.confirm()
            self._confirm_by_s = None
            self._event("BANK_CONFIRMED", f"bank {record.active}", self._request_id)
        self._telemetry(self._bank_report(record.active), self._request_id)
        return {}

    def _not_confirmed(self) -> None:
        self._fall_back("was not confirmed in time", 0)

    def _fall_back(self, why: str, request_id: int) -> None:
        self._confirm_by_s = None
        lost = self._memory.record.active
        kept = self._memory.fall_back()
        self._event("BANK_FELL_BACK", f"bank {lost} {why}; {kept} is active", request_id)
        problem = self._tracker.load_catalogue()
        if problem:
            self._event("BANK_CORRUPT", problem, request_id)
        for bank in (lost, kept):
            self._telemetry(self._bank_report(bank), request_id)

    def _do_rollback_bank(self, _: Mapping[str, Value]) -> Returns:
        if self._memory.record.previous == self._memory.record.active:
            raise Refusal("wrong_state", "no bank was active before")
        self._fall_back("was rolled back", self._request_id)
        return {}

    def _do_erase_bank(self, a: Mapping[str, Value]) -> Task:
        bank, request_id, record = str(a["bank"]), self._request_id, self._memory.record
        if bank == GOLDEN:
            raise Refusal("write_protected", "the golden bank cannot be erased")
        if bank == record.active or (record.unconfirmed and bank == record.previous):
            raise Refusal("bank_active", f"bank {bank} is in use")
        if self._loader.busy_with(bank):
            raise Refusal("busy", f"a transfer writes bank {bank}")
        yield 0.4
        self._memory.erase_bank(bank)
        self._event("BANK_ERASED", f"bank {bank}", request_id)
        self._telemetry(self._bank_report(bank), request_id)
        return {}

"""Command processing on board: checks, stored request ids, one running command, reports.

A handler returns its values immediately, or it is a generator that yields waiting times (device seconds) and finally
returns the values. It raises Rejection if the command cannot be executed.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass

from gss.device.protocol.codec import decode, encode, fixed_bytes
from gss.device.protocol.packet import Packet, PacketType
from gss.device.simulator.memory import Memory, StoredRequest
from gss.device.simulator.outbox import Outbox, short_text
from gss.device.simulator.rejection import Rejection
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.dictionary.checked_values import check_arguments
from gss.instruments.dictionary.definitions import CommandDefinition, Dictionary, Value

MAX_WAITING = 4
REPLAYED_AT = 3
"""Byte offset of the flag "replayed" in a report, after stage, reason and progress."""
UNFINISHED = (b"\1", b"\3", b"\4")

Returns = dict[str, Value]
Arguments = Mapping[str, Value]
Task = Generator[float, None, Returns]
Handler = Callable[[Arguments, int], "Returns | Task"]
Guard = Callable[[Arguments], None]
"""Function that raises Rejection if a command must not be accepted."""
Ended = Callable[[str, str, str], None]
"""Called with stage, reason and detail when a scheduled command ends."""


@dataclass
class Running:
    """A command that was accepted and has not ended."""

    request_id: int
    command: CommandDefinition
    arguments: Arguments
    task: Task | None = None
    due_s: float = 0.0
    on_end: Ended | None = None


class CommandProcessor:
    """Accepts command packets and runs handlers by name. ``state``: returns housekeeping, to evaluate preconditions.
    ``on_completed``: called with the name of each completed command."""

    def __init__(
        self,
        dictionary: Dictionary,
        memory: Memory,
        outbox: Outbox,
        state: Callable[[], Returns],
        on_completed: Callable[[str], None],
    ) -> None:
        self._dictionary, self._memory, self._outbox, self._state = dictionary, memory, outbox, state
        self.handlers: dict[str, Handler] = {}
        self.guards: dict[str, Guard] = {}
        self._on_completed = on_completed
        self._current: Running | None = None
        self._waiting: deque[Running] = deque()
        self.accepted = self.rejected = 0
        self._now_s = 0.0

    def add_handlers(self, handlers: Mapping[str, Handler], guards: Mapping[str, Guard] | None = None) -> None:
        """Add handlers and guards by command name. A guard checks a command's arguments before it is accepted. Handlers
        are added after construction, because they use this object to start commands."""
        self.handlers |= handlers
        self.guards |= guards or {}

    @property
    def busy(self) -> bool:
        """True if a command is running."""
        return self._current is not None

    def restart(self) -> None:
        """Restart after a reset: interrupted commands are reported as failed, now and when they are repeated."""
        if self._current is not None and self._current.task is not None:
            self._current.task.close()
        self._current = None
        self._waiting.clear()
        self.accepted = self.rejected = 0
        for request in list(self._memory.record.requests):
            if bytes.fromhex(request.report)[:1] in UNFINISHED:
                self._report(request, "failed", "reset", "the device restarted during the command")

    def note_id(self, request_id: int) -> None:
        """Update the highest received request id. HELLO reports it, so that the ground does not reuse ids."""
        record = self._memory.record
        record.last_request_id = max(record.last_request_id, request_id)

    # --- admission ----------------------------------------------------------------------------------------------

    def receive(self, packet: Packet, now_s: float) -> None:
        """Process a command packet."""
        self._now_s = now_s
        digest = hashlib.sha256(bytes([packet.code]) + packet.payload).hexdigest()
        command = self._dictionary.command_of_code(packet.code)
        stored = self._memory.request(packet.request_id)
        # HELLO and ABORT must work for a ground system that does not know earlier ids.
        if stored is not None and not (command and command.any_dictionary):
            self._repeat(stored, packet, digest)
            return
        if packet.request_id <= self._memory.record.forgotten_request_id and not (command and command.any_dictionary):
            # The command may have run earlier, and a replayed packet must never run a command again.
            self._reject_id(packet, "the report for this request id is no longer stored")
            return
        request = StoredRequest(packet.request_id, packet.code, digest, "")
        try:
            running = self._check_acceptance(command, packet)
        except Rejection as rejection:
            self.rejected += 1
            self._report(request, "rejected", rejection.reason, rejection.detail)
            return
        self.accepted += 1
        self._report(request, "accepted")
        if running.command.name == "ABORT":
            self._start(running)
        else:
            self._waiting.append(running)
            self.run(now_s)

    def _repeat(self, earlier: StoredRequest, packet: Packet, digest: str) -> None:
        """Answer a repeated id with the stored report marked as replayed, or reject it if the content differs."""
        if earlier.digest != digest:
            self._reject_id(packet, "this request id was used for another command")
            return
        stored = bytearray.fromhex(earlier.report)
        stored[REPLAYED_AT] = 1
        self._outbox.report(packet.request_id, packet.code, bytes(stored))

    def _reject_id(self, packet: Packet, detail: str) -> None:
        """Reject a command because of its request id. The rejection is not stored, because the stored report of this id
        belongs to another command."""
        self.rejected += 1
        self._outbox.report(packet.request_id, packet.code, self._payload("rejected", "id_reused", detail))

    def _check_acceptance(self, command: CommandDefinition | None, packet: Packet) -> Running:
        """Check a command before it is accepted. Raises Rejection."""
        if command is None:
            raise Rejection("unknown_command", f"code {packet.code}")
        if command.name not in self.handlers:
            raise Rejection("unknown_command", f"{command.name} is not available on this unit")
        if packet.prefix != self._dictionary.prefix and not command.any_dictionary:
            raise Rejection("wrong_dictionary", f"device {self._dictionary.prefix:04x}, ground {packet.prefix:04x}")
        try:
            arguments = check_arguments(command, decode(command.arguments, packet.payload).values)
        except CorruptData as error:
            right_length = len(packet.payload) == fixed_bytes(command.arguments)
            raise Rejection("out_of_range" if right_length else "bad_length", str(error)) from error
        except BadInput as error:
            raise Rejection("out_of_range", error.message) from error
        state = self._state() if command.preconditions else {}
        for condition in command.preconditions:
            if condition.met(state) is False:
                raise Rejection("wrong_state", f"not met: {condition.text}")
        if command.name in self.guards:
            self.guards[command.name](arguments)
        if len(self._waiting) >= MAX_WAITING:
            raise Rejection("busy", f"{MAX_WAITING} commands are waiting")
        return Running(packet.request_id, command, arguments)

    def run_scheduled(self, request_id: int, code: int, payload: bytes, on_end: Ended) -> None:
        """Check and run a scheduled command, without reports on the line and without using up an id."""
        packet = Packet(PacketType.COMMAND, code, request_id, payload, self._dictionary.prefix, True)
        try:
            running = self._check_acceptance(self._dictionary.command_of_code(code), packet)
        except Rejection as rejection:
            on_end("rejected", rejection.reason, rejection.detail)
            return
        running.on_end = on_end
        self._waiting.append(running)
        self.run(self._now_s)

    # --- running ------------------------------------------------------------------------------------------------

    def run(self, now_s: float) -> None:
        """Continue the running command and start waiting commands."""
        self._now_s = now_s
        while True:
            if self._current is None:
                if not self._waiting:
                    return
                self._start(self._waiting.popleft())
            elif now_s < self._current.due_s:
                return
            else:
                self._continue(self._current)

    def _start(self, running: Running) -> None:
        self._stage(running, "started")
        try:
            outcome = self.handlers[running.command.name](running.arguments, running.request_id)
        except Rejection as rejection:
            self._stage(running, "failed", rejection.reason, rejection.detail)
            return
        if isinstance(outcome, Generator):
            running.task, running.due_s = outcome, self._now_s
            self._current = running
        else:
            self._complete(running, outcome)

    def _continue(self, running: Running) -> None:
        assert running.task is not None  # noqa: S101 - only tasks become current
        try:
            running.due_s = self._now_s + next(running.task)
        except StopIteration as stop:
            self._current = None
            self._complete(running, stop.value)
        except Rejection as rejection:
            self._current = None
            self._stage(running, "failed", rejection.reason, rejection.detail)

    def _complete(self, running: Running, values: Returns) -> None:
        self._stage(running, "completed", returned=encode(running.command.returns, values))
        self._on_completed(running.command.name)

    def abort_all(self) -> int:
        """Fail all accepted commands that have not ended (ABORT). Returns the number of failed
        commands."""
        stopped = [r for r in (self._current, *self._waiting) if r is not None]
        self._current = None
        self._waiting.clear()
        for running in stopped:
            if running.task is not None:
                running.task.close()
            self._stage(running, "failed", "aborted", "stopped by ABORT")
        return len(stopped)

    # --- reports ------------------------------------------------------------------------------------------------

    def progress(self, percent: int) -> None:
        """Send a progress report. It is not stored; a repeated request gets the last stored report."""
        if self._current is not None and self._current.on_end is None:
            payload = self._payload("progress", percent=percent)
            self._outbox.report(self._current.request_id, self._current.command.code, payload)

    def _payload(self, stage: str, reason: str = "none", detail: str = "", percent: int = 0) -> bytes:
        values: Returns = {"stage": stage, "reason": reason, "replayed": False, "detail": short_text(detail)}
        values["progress"] = 100 if stage == "completed" else percent
        return encode(self._dictionary.service("REPORT").fields, values)

    def _stage(
        self, running: Running, stage: str, reason: str = "none", detail: str = "", returned: bytes = b""
    ) -> None:
        if running.on_end is not None:
            if stage in ("completed", "failed"):
                running.on_end(stage, reason, detail)
            return
        request = self._memory.request(running.request_id)
        if request is None:
            request = StoredRequest(running.request_id, running.command.code, "", "")
        self._report(request, stage, reason, detail, returned)

    def _report(
        self, request: StoredRequest, stage: str, reason: str = "none", detail: str = "", returned: bytes = b""
    ) -> None:
        payload = self._payload(stage, reason, detail) + returned
        command = self._dictionary.command_of_code(request.code)
        if command is None or not command.any_dictionary:
            self.note_id(request.request_id)
            self._memory.remember(StoredRequest(request.request_id, request.code, request.digest, payload.hex()))
        if stage not in ("accepted", "started"):
            self._memory.save()
        self._outbox.report(request.request_id, request.code, payload)

"""Host session with a third-party sensor: one request at a time, each followed by its response. No I/O.

An :class:`ExchangeWire` implements the protocol: it encodes requests and decodes responses. This module contains the
parts that all such protocols share: queue, timeouts, repeated requests, counters and the identity of the unit. These
sensors do not store request ids, so the ids only number requests on the ground.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

from gss.device.driver import InFlight, UnitSetup
from gss.device.no_transfers import ExchangeTransfers, NoTransfers
from gss.device.protocol.codec import Decoded, EncodedCommand
from gss.device.session_commands import CommandQueue, CommandRecord
from gss.device.session_events import (
    FINAL_STAGES,
    CommandUpdate,
    DeviceEvent,
    DirectionCounters,
    HelloReceived,
    LinkCounters,
    ReportFacts,
    SessionEvent,
    Stage,
    Telemetry,
    TransferUpdate,
)
from gss.device.session_transfer import RequestIds
from gss.domain.errors import Conflict
from gss.instruments.dictionary.definitions import Value
from gss.instruments.link_file import Poll

COUNTERS_EVERY_S = 1.0
GREET_AFTER_S = 3.0
"""Time without telemetry after which the greeting is sent again. A sensor that answers it without sending telemetry, for
example in its bootloader, then differs from a silent line."""
NO_ABORT = "This sensor has no command to abort."


@dataclass(frozen=True)
class SensorRequest:
    """A request in progress: its number on the ground, its command, and the encoded arguments."""

    request_id: int
    order: EncodedCommand


@dataclass(frozen=True)
class Answer:
    """Decoded content of one frame from the sensor. ``stage``: new stage of the request in progress, None if the frame
    does not concern that request. ``packet``: name of the telemetry packet in the frame, decoded in ``content``.
    ``time_s``: time of the sensor's clock, None if not reported. ``event``: name of the event in the frame, described
    by ``detail``. ``reply``: bytes to send next in the exchange. ``of_unit``: False if another node sent the frame."""

    stage: Stage | None = None
    reason: str = ""
    detail: str = ""
    values: Mapping[str, Value] = field(default_factory=dict)
    packet: str = ""
    content: Decoded = field(default_factory=Decoded)
    time_s: float | None = None
    event: str = ""
    reply: bytes = b""
    of_unit: bool = True


class ExchangeWire(Protocol):
    """Encoder and decoder of one protocol; pure."""

    def encode(self, name: str, arguments: Mapping[str, Value]) -> EncodedCommand: ...

    def frame(self, request: SensorRequest) -> bytes: ...

    def parts(self, request: SensorRequest) -> list[tuple[str, bytes]]: ...

    def sent(self, request: SensorRequest) -> None: ...

    def feed(self, data: bytes) -> list[Answer]: ...

    def restart(self) -> None: ...

    @property
    def received(self) -> DirectionCounters: ...


class ExchangeSession:
    """A :class:`gss.device.driver.Driver` for requests and responses. ``poll``: requests that the ground repeats;
    ``greeting``: command that the ground repeats while the sensor sends no telemetry. ``by_order``: True if only the order
    assigns a response to its request. After a timeout, nothing is then sent until the late response arrives or until the
    timed-out command's ``accept_s`` has passed again. Otherwise a late response would be assigned to the next request."""

    stores_results = False

    def __init__(
        self,
        setup: UnitSetup,
        wire: ExchangeWire,
        poll: Sequence[Poll] = (),
        pause_s: float = 0.0,
        greeting: str = "",
        transfers: ExchangeTransfers | None = None,
        by_order: bool = False,
    ) -> None:
        self._setup, self._wire, self._pause_s, self._by_order = setup, wire, pause_s, by_order
        self.framing = setup.framing or setup.link.framing
        self.transfers: ExchangeTransfers = transfers or NoTransfers()
        self._replies: list[bytes] = []
        self._ids, self._queue = RequestIds(1), CommandQueue()
        self._orders: dict[int, EncodedCommand] = {}
        self._polls = [(wire.encode(p.command, {}), p.every_s) for p in poll]
        self._greeting = wire.encode(greeting, {}) if greeting else None
        self._greet_s = 0.0
        self._due_s = [0.0] * len(self._polls)
        self._events: list[SessionEvent] = []
        self._up = False
        self._current: SensorRequest | None = None
        self._polled_until_s: float | None = None
        self._free_s = self._counted_s = -1e9
        self._last_good_s: float | None = None
        self._telemetry_s = -1e9
        self._housekeeping: Mapping[str, Value] | None = None
        self._hello: HelloReceived | None = None
        self._greeted = False
        self._sent = DirectionCounters()

    # --- commands -----------------------------------------------------------------------------------------------

    def encode(self, name: str, arguments: Mapping[str, Value]) -> EncodedCommand:
        """Validate and encode a command. Raises BadInput, NotFound."""
        return self._wire.encode(name, arguments)

    def submit(self, order: EncodedCommand, *, request_id: int | None = None) -> int:
        """Queue a command and return its request id."""
        used = self._ids() if request_id is None else request_id
        self._orders[used] = order
        self._events.append(self._queue.add(used, order))
        return used

    def reserve(self) -> int:
        """Return a request id for a later ``submit``."""
        return self._ids()

    def check_allowed(self, name: str) -> None:
        """Raise NotFound if there is no such command."""
        self._setup.dictionary.command(name)

    def preview(self, order: EncodedCommand) -> list[tuple[str, bytes]]:
        """Return the packet before framing as labelled groups (dry run)."""
        return self._wire.parts(SensorRequest(self._ids.following, order))

    def check_retry(self, request_id: int) -> None:
        """Raise Conflict or NotFound if the command cannot be retried."""
        self._queue.check_retry(request_id)

    def retry(self, request_id: int, now_s: float) -> None:
        """Send the same command again; see ``check_retry``."""
        self._events.append(self._queue.retry(request_id))

    def withdraw(self, request_id: int, detail: str) -> CommandUpdate:
        """Withdraw a queued command. Raises Conflict if the command is not in the queue."""
        return self._queue.withdraw(request_id, detail)

    def withdraw_all(self, detail: str) -> list[CommandUpdate]:
        """Withdraw all queued commands."""
        return self._queue.clear(detail)

    def abort(self, now_s: float) -> int:
        """Raise Conflict: these sensors have no command to abort."""
        raise Conflict(NO_ABORT)

    def acknowledge_mismatch(self) -> None:
        """Do nothing: these sensors do not report a dictionary."""

    def restore(self, next_request_id: int, in_flight: Sequence[InFlight], next_transfer_id: int = 1) -> None:
        """Set the next ids after a restart. Commands ``in_flight`` get the stage UNKNOWN and can be retried."""
        self._ids.following = next_request_id
        for request_id, order, unit in in_flight:
            self._orders[request_id] = order
            self._events.append(self._queue.add_unknown(request_id, order, unit))

    def transfer(self, transfer_id: int) -> TransferUpdate:
        """Return the state of a transfer. Raises NotFound."""
        return self.transfers.update(transfer_id)

    # --- line ---------------------------------------------------------------------------------------------------

    def link_up(self, now_s: float) -> None:
        """Reset the session for a newly opened port."""
        self._wire.restart()
        self._up, self._greeted, self._replies = True, False, []
        self._current, self._polled_until_s, self._free_s = None, None, now_s
        self._greet_s, self._telemetry_s = now_s, -1e9
        self._due_s = [now_s] * len(self._polls)

    def link_lost(self, now_s: float) -> list[SessionEvent]:
        """Handle the loss of the port: a command that was sent becomes UNKNOWN."""
        self._up, self._current, self._polled_until_s = False, None, None
        self.transfers.lose()
        self._events += self._queue.lose_all("The line was lost while the command was under way.")
        return self._take_events()

    def feed(self, data: bytes, now_s: float) -> list[SessionEvent]:
        """Process received bytes and return the resulting events. Invalid bytes raise no exception."""
        for answer in self._wire.feed(data):
            if answer.of_unit:
                self._last_good_s = now_s
                self._greet(answer)
            request = self._current
            self._replies += [answer.reply] if answer.reply else []
            if answer.event:
                self._event(answer)
            if answer.packet:
                self._telemetry(answer, request, now_s)
            if request is not None and answer.stage is not None:
                self._report(request, answer, now_s)
            elif answer.stage in FINAL_STAGES:  # the late response to a request that timed out
                self._free_s = min(self._free_s, now_s + self._pause_s)
        return self._take_events()

    def poll(self, now_s: float) -> tuple[bytes, list[SessionEvent]]:
        """Return the bytes to write now and the events since the last call."""
        out = b""
        if self._up:
            self._expire(now_s)
            out = self._counted(*self._replies, self.transfers.poll(now_s))
            self._replies = []
            if self._current is None and now_s >= self._free_s and not self.transfers.holds_channel:
                out += self._next(now_s) or (self._counted(self.transfers.begin(now_s)) if self._greeted else b"")
        if now_s - self._counted_s >= COUNTERS_EVERY_S:
            self._counted_s = now_s
            self._events.append(self.counters)
        return out, self._take_events()

    def _expire(self, now_s: float) -> None:
        events = self._queue.expire(now_s)
        self._events += events
        current = self._current
        if current is None:
            return
        timed_out = self._polled_until_s is not None and now_s >= self._polled_until_s
        if timed_out or any(event.request_id == current.request_id for event in events):
            self._end(now_s + (current.order.command.accept_s if self._by_order else 0.0))

    def _next(self, now_s: float) -> bytes:
        records, events = self._queue.release(now_s)
        self._events += events
        if records:
            return self._send(SensorRequest(records[0].request_id, self._order_of(records[0])))
        silent = now_s - self._telemetry_s > GREET_AFTER_S
        if self._greeting is not None and silent and now_s >= self._greet_s:
            self._greet_s = now_s + self._setup.link.hello_again_s
            return self._send_automatic(self._greeting, now_s)
        for k, (order, every_s) in enumerate(self._polls):
            if now_s >= self._due_s[k]:
                self._due_s[k] = now_s + every_s
                return self._send_automatic(order, now_s)
        return b""

    def _send_automatic(self, order: EncodedCommand, now_s: float) -> bytes:
        """Send a request that the session repeats automatically."""
        self._polled_until_s = now_s + order.command.accept_s + order.command.complete_s
        return self._send(SensorRequest(0, order))

    def _order_of(self, record: CommandRecord) -> EncodedCommand:
        return self._orders[record.request_id]

    def _send(self, request: SensorRequest) -> bytes:
        self._current = request
        data = self._counted(self._wire.frame(request))
        self._wire.sent(request)
        return data

    def _counted(self, *messages: bytes) -> bytes:
        """Count messages as sent and return them together."""
        out, count = b"".join(messages), sum(bool(message) for message in messages)
        self._sent = replace(self._sent, bytes=self._sent.bytes + len(out), good=self._sent.good + count)
        return out

    def _end(self, now_s: float) -> None:
        """Finish the exchange; the next request can be sent after the pause."""
        self._current, self._polled_until_s, self._free_s = None, None, now_s + self._pause_s

    # --- received frames ----------------------------------------------------------------------------------------

    def _report(self, request: SensorRequest, answer: Answer, now_s: float) -> None:
        if answer.stage is None:
            return
        if request.request_id:
            facts: ReportFacts = {"reason": answer.reason, "detail": answer.detail, "values": answer.values}
            self._events += self._queue.report(request.request_id, answer.stage, now_s, facts)
        if answer.stage in FINAL_STAGES:
            self._orders.pop(request.request_id, None)  # only a command with an unknown outcome can be sent again
            self._end(now_s)

    def _telemetry(self, answer: Answer, request: SensorRequest | None, now_s: float) -> None:
        content = answer.content
        request_id = request.request_id if request is not None and answer.stage is not None else 0
        time_s = answer.time_s or 0.0
        self._telemetry_s = now_s
        if answer.packet == "housekeeping":
            self._housekeeping = content.values
        self._events.append(Telemetry(answer.packet, time_s, request_id, content.raw, content.values, content.lists))

    def _event(self, answer: Answer) -> None:
        row = self._setup.dictionary.event_named(answer.event)
        self._events.append(DeviceEvent(row.name, row.severity, answer.detail, answer.time_s or 0.0))

    def _greet(self, answer: Answer) -> None:
        """Report the identity of the unit at the first valid frame."""
        if self._greeted:
            return
        self._greeted, self._hello = True, self._setup.identity(answer.time_s or 0.0)
        self._events.append(self._hello)

    def _take_events(self) -> list[SessionEvent]:
        events, self._events = [*self._events, *self.transfers.news()], []
        return events

    # --- state --------------------------------------------------------------------------------------------------

    @property
    def counters(self) -> LinkCounters:
        """Counters since the session was created."""
        return LinkCounters(self._sent, self._wire.received, self._last_good_s)

    @property
    def next_request_id(self) -> int:
        """Request id of the next command."""
        return self._ids.following

    @property
    def housekeeping(self) -> Mapping[str, Value] | None:
        """Latest housekeeping in engineering units; None before the first packet."""
        return self._housekeeping

    @property
    def hello(self) -> HelloReceived | None:
        """Identity of the unit as last reported."""
        return self._hello

    @property
    def device_dictionary_hash(self) -> str | None:
        """Always None: these protocols do not report a dictionary."""
        return None

"""Present and serialize each bus message once, independent of the number of listeners."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable
from typing import Any

from gss.api import present
from gss.api.stream.fanout import FIRST, Fanout, Wire, wire
from gss.operations.events import EventBus, Message
from gss.operations.line.status import StatusService

log = logging.getLogger("gss.stream")
PRESENT: dict[str, Callable[[Any], Any]] = {
    "link": present.link.link,
    "telemetry": present.telemetry.latest,
    "command": present.commands.command,
    "schedule": present.schedule.schedule,
    "stack_run": present.stacks.run,
    "authority": present.authority.authority,
    "transfer": present.records.transfer,
    "frame": lambda frame: present.frames.frame(frame, None),
    "solution": present.frames.solution,
    "job": present.records.job,
    "event": present.records.event,
    "cycle": present.telemetry.cycle,
    "tables": present.tables.on_board,
    "limits": lambda change: change,
    "alarm": present.alarms.alarm,
    "replay": present.contacts.replay,
    "replay.telemetry": present.telemetry.latest,
    "replay.command": present.contacts.replay_command,
    "replay.event": present.contacts.replay_event,
}


def first_state(status: StatusService) -> Wire:
    """Return the initial state for a listener when none has been published yet."""
    return wire(FIRST, present.link.link(status.header()), None)


class Presenter:
    """Thread between the event bus and the fan-out.

    Recorded events carry their number as ``id``; other messages carry the number of the newest event and, after a
    point, a separate counter. A gap in either means that messages were lost.
    """

    def __init__(self, bus: EventBus, fanout: Fanout, stopping: threading.Event) -> None:
        self._bus, self._fanout, self._stopping = bus, fanout, stopping
        self._wake = threading.Event()
        self._seq = self._count = 0
        self._thread = threading.Thread(target=self._run, name="stream", daemon=True)
        self._loop: asyncio.AbstractEventLoop | None = None

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Subscribe to the bus and start the thread; messages are passed to the fan-out on ``loop``."""
        self._loop = loop
        self._subscription = self._bus.subscribe(self._wake.set)
        self._seq = self._bus.newest()
        self._thread.start()

    def stop(self) -> None:
        """End the thread; ``stopping`` must be set."""
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5)

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._wake.wait()
                self._wake.clear()
                messages, dropped = self._subscription.take()
                self._hand_over(self._presented(messages, dropped))
        finally:
            self._bus.unsubscribe(self._subscription)
            self._on_loop(self._fanout.close)

    def _presented(self, messages: list[Message], dropped: int) -> list[Wire]:
        """Return the messages serialized, in order. Without listeners they are only counted, except the state."""
        wires: list[Wire] = []
        if dropped:
            self._count += dropped
            wires.append(wire("dropped", {"dropped": dropped}, None))
        heard = len(self._fanout) > 0
        for message in messages:
            if message.seq is not None:
                self._seq = max(self._seq, message.seq)
            else:
                self._count += 1
            if not heard and message.topic != FIRST:
                continue
            number = str(self._seq) if message.seq is not None else f"{self._seq}.{self._count}"
            try:
                wires.append(wire(message.topic, PRESENT[message.topic](message.payload), number, message.seq))
            except Exception:  # one message that fails to serialize must not end the stream
                log.exception("a message of %s could not be presented", message.topic)
                wires.append(wire("dropped", {"dropped": 1}, None))
        return wires

    def _hand_over(self, wires: list[Wire]) -> None:
        if wires:
            self._on_loop(self._fanout.spread, wires)

    def _on_loop(self, call: Callable[..., None], *arguments: Any) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(call, *arguments)

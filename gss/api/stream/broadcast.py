"""From the event bus to the connections: each message is serialized once and its bytes are shared by all listeners.

``Presenter`` serializes on a thread; ``Broadcaster`` and the listeners run on the event loop.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from pydantic_core import to_json

from gss.api import present
from gss.api.stream.topics import PRESENT
from gss.domain.errors import RateLimited
from gss.operations.events import EventBus, Message
from gss.operations.metrics import StreamCounts
from gss.operations.upkeep.status import StatusService

log = logging.getLogger("gss.stream")

MAILBOX = 2000
MAILBOX_BYTES = 16 << 20
AGAIN_S = 10.0
FIRST = "link"
"""Topic of the state that a new listener receives first."""


@dataclass(frozen=True, slots=True)
class Wire:
    """One serialized message. ``seq``: number of a recorded event."""

    topic: str
    data: bytes
    seq: int | None = None

    @property
    def content(self) -> bytes:
        """The JSON of the message, which has no line break."""
        return self.data.partition(b"\ndata: ")[2].partition(b"\n")[0]


def wire(topic: str, payload: Any, number: str | None, seq: int | None = None) -> Wire:
    """Return a server-sent event. ``payload``: anything that JSON can hold; ``number``: its ``id``."""
    return _wire(topic, to_json(payload, by_alias=True), number, seq)


def received(topic: str, data: str, number: str) -> Wire:
    """Return a message of the event stream of another process. ``number``: as parsed, which repeats the previous ``id``
    for a message that has none, as "dropped"."""
    seq = int(number) if topic == "event" else None
    return _wire(topic, data.encode(), None if topic == "dropped" else number or None, seq)


def _wire(topic: str, data: bytes, number: str | None, seq: int | None) -> Wire:
    ident = b"" if number is None else b"id: %s\n" % number.encode()
    return Wire(topic, b"event: %s\ndata: %s\n%s\n" % (topic.encode(), data, ident), seq)


def unnumbered(message: Wire) -> bytes:
    """Return the message without its ``id``."""
    head, mark, _ = message.data.partition(b"\nid: ")  # JSON contains no line break, so this can only be the id field
    return head + b"\n\n" if mark else message.data


class Listener:
    """Message queue of one connection. If the client reads too slowly, the oldest messages are dropped and counted."""

    def __init__(self, name: str = "") -> None:
        self.name = name
        self.ready = asyncio.Event()
        self.closed = False
        self._waiting: deque[Wire] = deque()
        self._bytes = 0
        self._dropped = 0

    def put(self, messages: Iterable[Wire]) -> None:
        """Append messages; their bytes are shared between listeners."""
        for message in messages:
            self._waiting.append(message)
            self._bytes += len(message.data)
        while len(self._waiting) > MAILBOX or (self._bytes > MAILBOX_BYTES and len(self._waiting) > 1):
            self._bytes -= len(self._waiting.popleft().data)
            self._dropped += 1
        self.ready.set()

    def take(self) -> tuple[list[Wire], int]:
        """Remove and return all queued messages, and the number dropped before them."""
        messages, dropped = list(self._waiting), self._dropped
        self._waiting.clear()
        self._bytes = self._dropped = 0
        self.ready.clear()
        return messages, dropped

    def close(self) -> None:
        """End the connection."""
        self.closed = True
        self.ready.set()


class Broadcaster:
    """Sends each message to every listener and keeps the newest state for new ones. ``each``, ``most``: maximum
    listeners per user and in total; 0 means no limit. ``counts`` is updated."""

    def __init__(
        self, counts: StreamCounts, state: Callable[[], Wire] | None = None, each: int = 0, most: int = 0
    ) -> None:
        self.counts = counts
        self.state = state
        """Computes the initial state in a thread if no state has been published yet; None in a worker."""
        self._each, self._most = each, most
        self.newest: Wire | None = None
        self._listeners: set[Listener] = set()
        self._closed = False

    def __len__(self) -> int:
        return len(self._listeners)

    def join(self, name: str = "") -> Listener:
        """Create a listener queue for a user. RateLimited if a limit is reached; anonymous listeners are not limited.
        While the server is stopping, return a closed queue."""
        limits = (("one user or token", self._each, self._of(name)), ("everybody", self._most, len(self._listeners)))
        for owner, most, open_count in limits:
            if name and most and open_count >= most:
                self.counts.refused += 1
                raise RateLimited(
                    "too many open event streams",
                    expected=f"at most {most} of {owner}",
                    got=str(open_count),
                    hint="close unused pages or programs; GSS_STREAMS_EACH, GSS_STREAMS_MOST",
                    retry_after_s=AGAIN_S,
                )
        listener = Listener(name)
        if self._closed:
            listener.close()
        self._listeners.add(listener)
        self.counts.clients = len(self._listeners)
        return listener

    def _of(self, name: str) -> int:
        return sum(listener.name == name for listener in self._listeners)

    def leave(self, listener: Listener) -> None:
        """Remove a listener."""
        self._listeners.discard(listener)
        self.counts.clients = len(self._listeners)

    def spread(self, messages: Iterable[Wire]) -> None:
        """Send messages to every listener."""
        messages = tuple(messages)
        for message in messages:
            if message.topic == FIRST:
                self.newest = message
        for listener in self._listeners:
            listener.put(messages)

    def hang_up(self) -> None:
        """End every connection; clients may reconnect."""
        self.newest = None
        for listener in tuple(self._listeners):
            listener.close()

    def close(self) -> None:
        """End every connection, and any opened later."""
        self._closed = True
        self.hang_up()


def first_state(status: StatusService) -> Wire:
    """Return the initial state for a listener when none has been published yet."""
    return wire(FIRST, present.link.link(status.header()), None)


class Presenter:
    """Thread between the event bus and the fan-out.

    Recorded events carry their number as ``id``; other messages carry the number of the newest event and, after a
    point, a separate counter. A gap in either means that messages were lost.
    """

    def __init__(self, bus: EventBus, broadcaster: Broadcaster, stopping: threading.Event) -> None:
        self._bus, self._broadcaster, self._stopping = bus, broadcaster, stopping
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
            self._on_loop(self._broadcaster.close)

    def _presented(self, messages: list[Message], dropped: int) -> list[Wire]:
        """Return the messages serialized, in order. Without listeners they are only counted, except the state."""
        wires: list[Wire] = []
        if dropped:
            self._count += dropped
            wires.append(wire("dropped", {"dropped": dropped}, None))
        has_listeners = len(self._broadcaster) > 0
        for message in messages:
            if message.seq is not None:
                self._seq = max(self._seq, message.seq)
            else:
                self._count += 1
            if not has_listeners and message.topic != FIRST:
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
            self._on_loop(self._broadcaster.spread, wires)

    def _on_loop(self, call: Callable[..., None], *arguments: Any) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(call, *arguments)

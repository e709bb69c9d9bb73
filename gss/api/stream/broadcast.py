"""Send messages of the event bus to the connections. Each message is serialized once, and all listeners share its
bytes.

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

MAX_QUEUED = 2000
MAX_QUEUED_BYTES = 16 << 20
RETRY_AFTER_S = 10.0
FIRST = "link"
"""Topic of the initial state of a new listener."""


@dataclass(frozen=True, slots=True)
class Wire:
    """One serialized message. ``seq``: number of a recorded event, else None."""

    topic: str
    data: bytes
    seq: int | None = None

    @property
    def content(self) -> bytes:
        """JSON of the message, which contains no line break."""
        return self.data.partition(b"\ndata: ")[2].partition(b"\n")[0]


def wire(topic: str, payload: Any, number: str | None, seq: int | None = None) -> Wire:
    """Return a server-sent event. ``payload``: value that JSON can represent; ``number``: ``id`` of the message."""
    return _wire(topic, to_json(payload, by_alias=True), number, seq)


def received(topic: str, data: str, number: str) -> Wire:
    """Return a message from the event stream of another process. ``number``: ``id`` from the parser, which repeats the
    previous ``id`` for a message without one, such as "dropped"."""
    seq = int(number) if topic == "event" else None
    return _wire(topic, data.encode(), None if topic == "dropped" else number or None, seq)


def _wire(topic: str, data: bytes, number: str | None, seq: int | None) -> Wire:
    ident = b"" if number is None else b"id: %s\n" % number.encode()
    return Wire(topic, b"event: %s\ndata: %s\n%s\n" % (topic.encode(), data, ident), seq)


def unnumbered(message: Wire) -> bytes:
    """Return the message without its ``id``."""
    head, mark, _ = message.data.partition(b"\nid: ")  # JSON contains no line break, so the match is the id field
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
        """Append messages, whose bytes all listeners share. Above the limits, drop the oldest messages."""
        for message in messages:
            self._waiting.append(message)
            self._bytes += len(message.data)
        while len(self._waiting) > MAX_QUEUED or (self._bytes > MAX_QUEUED_BYTES and len(self._waiting) > 1):
            self._bytes -= len(self._waiting.popleft().data)
            self._dropped += 1
        self.ready.set()

    def take(self) -> tuple[list[Wire], int]:
        """Remove and return all queued messages, and return the number of messages dropped before them."""
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
    """Sends each message to every listener and stores the latest state for new listeners. ``each``, ``most``: maximum
    number of listeners per user and in total; 0: no limit. ``counts``: counters to update."""

    def __init__(
        self, counts: StreamCounts, state: Callable[[], Wire] | None = None, each: int = 0, most: int = 0
    ) -> None:
        self.counts = counts
        self.state = state
        """Function that computes the initial state if no state has been published; None in a worker. The function
        blocks, so it is called in a thread."""
        self._each, self._most = each, most
        self.newest: Wire | None = None
        self._listeners: set[Listener] = set()
        self._closed = False

    def __len__(self) -> int:
        return len(self._listeners)

    def join(self, name: str = "") -> Listener:
        """Create a listener queue for a user. Raises RateLimited if a limit is reached; anonymous listeners are not
        limited. While the server is stopping, return a closed queue."""
        limits = (
            ("one user or token", self._each, self._count_of(name)),
            ("all users", self._most, len(self._listeners)),
        )
        for owner, max_streams, open_count in limits:
            if name and max_streams and open_count >= max_streams:
                self.counts.refused += 1
                raise RateLimited(
                    "too many open event streams",
                    expected=f"at most {max_streams} for {owner}",
                    got=str(open_count),
                    hint="close unused pages or programs, or raise GSS_STREAMS_EACH or GSS_STREAMS_MOST",
                    retry_after_s=RETRY_AFTER_S,
                )
        listener = Listener(name)
        if self._closed:
            listener.close()
        self._listeners.add(listener)
        self.counts.clients = len(self._listeners)
        return listener

    def _count_of(self, name: str) -> int:
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
        """End every connection. Clients can reconnect."""
        self.newest = None
        for listener in tuple(self._listeners):
            listener.close()

    def close(self) -> None:
        """End every connection, and immediately end later connections."""
        self._closed = True
        self.hang_up()


def first_state(status: StatusService) -> Wire:
    """Return the initial state for a listener if no state has been published."""
    return wire(FIRST, present.link.link(status.header()), None)


class Presenter:
    """Thread that serializes messages of the event bus for the broadcaster.

    The ``id`` of a recorded event is its number. The ``id`` of any other message is the number of the newest event,
    followed by a point and the value of a separate counter. A gap in either number means that messages were lost.
    """

    def __init__(self, bus: EventBus, broadcaster: Broadcaster, stopping: threading.Event) -> None:
        self._bus, self._broadcaster, self._stopping = bus, broadcaster, stopping
        self._wake = threading.Event()
        self._seq = self._count = 0
        self._thread = threading.Thread(target=self._run, name="stream", daemon=True)
        self._loop: asyncio.AbstractEventLoop | None = None

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Subscribe to the bus and start the thread; messages are passed to the broadcaster on ``loop``."""
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
                self._send(self._serialized(messages, dropped))
        finally:
            self._bus.unsubscribe(self._subscription)
            self._on_loop(self._broadcaster.close)

    def _serialized(self, messages: list[Message], dropped: int) -> list[Wire]:
        """Return the serialized messages in order. Without listeners, messages other than the state are only
        counted."""
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
                log.exception("a message of %s could not be serialized", message.topic)
                wires.append(wire("dropped", {"dropped": 1}, None))
        return wires

    def _send(self, wires: list[Wire]) -> None:
        if wires:
            self._on_loop(self._broadcaster.spread, wires)

    def _on_loop(self, call: Callable[..., None], *arguments: Any) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(call, *arguments)

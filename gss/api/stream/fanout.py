"""Serialized messages and the listeners that share them. Everything here runs on the event loop."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from pydantic_core import to_json

from gss.domain.errors import TooOften
from gss.operations.events import StreamCounts

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


def wire(topic: str, payload: Any, number: str | None, seq: int | None = None) -> Wire:
    """Return a server-sent event. ``payload``: anything that JSON can hold; ``number``: its ``id``."""
    ident = b"" if number is None else b"id: %s\n" % number.encode()
    data = b"event: %s\ndata: %s\n%s\n" % (topic.encode(), to_json(payload, by_alias=True), ident)
    return Wire(topic, data, seq)


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


class Fanout:
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
        """Create a listener queue for a user. TooOften if a limit is reached; anonymous listeners are not limited.
        While the server is stopping, return a closed queue."""
        limits = (("one user or token", self._each, self._of(name)), ("everybody", self._most, len(self._listeners)))
        for whom, most, there in limits:
            if name and most and there >= most:
                self.counts.refused += 1
                raise TooOften(
                    "too many event streams are open",
                    expected=f"at most {most} of {whom}",
                    got=str(there),
                    hint="close pages or programs that are not needed; GSS_STREAMS_EACH, GSS_STREAMS_MOST",
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

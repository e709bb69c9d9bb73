"""Messages that are ready to be sent, and the listeners who share their bytes. Everything here runs on the event loop."""

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
"""The state that a new listener gets before anything else."""


@dataclass(frozen=True, slots=True)
class Wire:
    """One message as it goes out. ``seq``: number of a recorded event."""

    topic: str
    data: bytes
    seq: int | None = None


def wire(topic: str, payload: Any, number: str | None, seq: int | None = None) -> Wire:
    """A server-sent event; ``payload`` is anything that JSON can hold, ``number`` its ``id``."""
    ident = b"" if number is None else b"id: %s\n" % number.encode()
    data = b"event: %s\ndata: %s\n%s\n" % (topic.encode(), to_json(payload, by_alias=True), ident)
    return Wire(topic, data, seq)


def unnumbered(message: Wire) -> bytes:
    """The message without its ``id``."""
    head, mark, _ = message.data.partition(b"\nid: ")  # JSON holds no line break, so this can only be the field
    return head + b"\n\n" if mark else message.data


class Listener:
    """One connection's mailbox. A connection that takes too slowly loses the oldest messages; they are counted."""

    def __init__(self, name: str = "") -> None:
        self.name = name
        self.ready = asyncio.Event()
        self.closed = False
        self._waiting: deque[Wire] = deque()
        self._bytes = 0
        self._dropped = 0

    def put(self, messages: Iterable[Wire]) -> None:
        """Add messages, shared with every other listener."""
        for message in messages:
            self._waiting.append(message)
            self._bytes += len(message.data)
        while len(self._waiting) > MAILBOX or (self._bytes > MAILBOX_BYTES and len(self._waiting) > 1):
            self._bytes -= len(self._waiting.popleft().data)
            self._dropped += 1
        self.ready.set()

    def take(self) -> tuple[list[Wire], int]:
        """All waiting messages, and how many were lost before them."""
        messages, dropped = list(self._waiting), self._dropped
        self._waiting.clear()
        self._bytes = self._dropped = 0
        self.ready.clear()
        return messages, dropped

    def close(self) -> None:
        """Let the connection end."""
        self.closed = True
        self.ready.set()


class Fanout:
    """Gives each message to every listener and keeps the newest state that a new one begins with. ``each``, ``most``: limits for
    the listeners of one name, and for all together; 0 is no limit. ``counts`` is kept up to date."""

    def __init__(
        self, counts: StreamCounts, state: Callable[[], Wire] | None = None, each: int = 0, most: int = 0
    ) -> None:
        self.counts = counts
        self.state = state
        """Works out what a new listener begins with, in a thread, while nothing has been told yet; a worker cannot."""
        self._each, self._most = each, most
        self.newest: Wire | None = None
        self._listeners: set[Listener] = set()
        self._closed = False

    def __len__(self) -> int:
        return len(self._listeners)

    def join(self, name: str = "") -> Listener:
        """A new mailbox of somebody, nobody's counts for none; of a server that stops one that is closed already. TooOften where
        there are as many as may be."""
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
        """Close a mailbox."""
        self._listeners.discard(listener)
        self.counts.clients = len(self._listeners)

    def spread(self, messages: Iterable[Wire]) -> None:
        """Give messages to everybody."""
        messages = tuple(messages)
        for message in messages:
            if message.topic == FIRST:
                self.newest = message
        for listener in self._listeners:
            listener.put(messages)

    def hang_up(self) -> None:
        """End every connection; whoever wants may come again."""
        self.newest = None
        for listener in tuple(self._listeners):
            listener.close()

    def close(self) -> None:
        """End every connection, and those that still come."""
        self._closed = True
        self.hang_up()

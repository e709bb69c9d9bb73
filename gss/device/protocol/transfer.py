"""Transfer protocol without I/O: selects the chunks to send and tracks the stored chunks. Both ends use it in both
directions.

A transfer is divided into numbered chunks. The sender keeps at most one window of chunks in flight; single chunks are
not acknowledged. The receiver periodically reports (STATUS) which ranges it has stored and the highest ``serial`` it
has received; every chunk sent carries the next serial. A serial line keeps order, so a chunk with a lower serial that
is not stored is lost, and only lost chunks are sent again. If no STATUS arrives, the sender requests one
(STATUS_REQUEST).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from gss.device.protocol.codec import Decoded
from gss.instruments.dictionary.definitions import Value

PAGE_RANGES = 16
REQUEST_BACKOFF = 1.6
MAX_REQUEST_S = 3.0
ANSWER_S = 0.25
STATUS_EVERY = 4
"""A receiver reports after a quarter of a window."""


@dataclass(frozen=True)
class Compatibility:
    """Properties of an upload that the device checks, to reject incompatible content. Zero if not applicable
    (images)."""

    device_model: str = ""
    profile: str = ""
    dictionary_hash: bytes = bytes(32)
    format_version: int = 0
    epoch_jyear: float = 0.0
    stars: int = 0
    pairs: int = 0


@dataclass(frozen=True)
class StatusPage:
    """A receiver's report on the chunks ``from_index`` to ``to_index`` − 1. ``ranges``: the chunks among these that the
    receiver has stored (first and last, inclusive)."""

    serial: int
    stored_chunks: int
    from_index: int
    to_index: int
    ranges: tuple[tuple[int, int], ...]

    def values(self, session: int) -> dict[str, Value]:
        """Return the fields of a STATUS message."""
        return {
            "session": session,
            "serial": self.serial,
            "stored_chunks": self.stored_chunks,
            "from_index": self.from_index,
            "to_index": self.to_index,
        }

    def lists(self) -> dict[str, list[Mapping[str, Value]]]:
        """Return the lists of a STATUS message."""
        return {"ranges": [{"first": first, "last": last} for first, last in self.ranges]}

    @classmethod
    def of(cls, message: Decoded) -> StatusPage:
        """Return the status page in a decoded STATUS message."""
        values = {name: int(value) for name, value in message.values.items()}
        ranges = tuple((int(r["first"]), int(r["last"])) for r in message.lists["ranges"])
        return cls(values["serial"], values["stored_chunks"], values["from_index"], values["to_index"], ranges)


def chunk_count(size: int, chunk_bytes: int) -> int:
    """Return the number of chunks in a transfer of ``size`` bytes."""
    return -(-size // chunk_bytes)


def request_patience_s(window: int, chunk_bytes: int, bytes_per_s: float | None) -> float:
    """Return the time in seconds after which a sender requests a STATUS: the time until a STATUS is due, plus a
    response time.

    Without a line rate only the response time is counted.
    """
    if not bytes_per_s:
        return ANSWER_S
    return ANSWER_S + (window // STATUS_EVERY + 2) * (chunk_bytes + 64) / bytes_per_s


class ChunkSet:
    """Set of the stored chunks out of ``count``."""

    def __init__(self, count: int, stored: Iterable[int] = ()) -> None:
        self._flags = bytearray(count)
        self.stored = 0
        self._first_missing = 0
        for index in stored:
            self.add(index)

    def __len__(self) -> int:
        return len(self._flags)

    def __contains__(self, index: int) -> bool:
        return 0 <= index < len(self._flags) and self._flags[index] == 1

    @property
    def complete(self) -> bool:
        """True if no chunk is missing."""
        return self.stored == len(self._flags)

    @property
    def first_missing(self) -> int:
        """Number of the first missing chunk; the chunk count if none is missing."""
        at = self._flags.find(0, self._first_missing)
        self._first_missing = len(self._flags) if at < 0 else at
        return self._first_missing

    def add(self, index: int) -> bool:
        """Mark a chunk as stored. Returns False if it is already stored or does not exist."""
        if not 0 <= index < len(self._flags) or self._flags[index]:
            return False
        self._flags[index] = 1
        self.stored += 1
        return True

    def add_range(self, first: int, last: int) -> None:
        """Mark the chunks from first to last (inclusive) as stored. Invalid numbers are ignored."""
        first, last = max(first, 0), min(last, len(self._flags) - 1)
        if first <= last:
            self.stored += self._flags.count(0, first, last + 1)
            self._flags[first : last + 1] = b"\1" * (last + 1 - first)

    def ranges(self, start: int = 0, limit: int | None = None) -> tuple[tuple[tuple[int, int], ...], int]:
        """Return at most ``limit`` stored ranges from ``start`` on, and the chunk number up to which they are
        complete."""
        ranges: list[tuple[int, int]] = []
        at, count = start, len(self._flags)
        while True:
            first = self._flags.find(1, at)
            if first < 0:
                return tuple(ranges), count
            if limit is not None and len(ranges) == limit:
                return tuple(ranges), first
            gap = self._flags.find(0, first)
            at = count if gap < 0 else gap
            ranges.append((first, at - 1))

    def stored_bytes(self, size: int, chunk_bytes: int) -> int:
        """Return the number of bytes in the stored chunks; the last chunk may be short."""
        count = len(self._flags)
        short = count * chunk_bytes - size if count and (count - 1) in self else 0
        return self.stored * chunk_bytes - short


class ChunkSender:
    """Chooses the next chunk to send. ``stored``: chunks that the receiver has acknowledged."""

    def __init__(self, count: int, window: int, request_after_s: float, *, resumed: bool = False) -> None:
        self.stored = ChunkSet(count)
        self._window = window
        self._flight: dict[int, int] = {}
        self._again: deque[int] = deque()
        self._next = 0
        # A resumed transfer sends no chunks until status pages have reported all chunks that the receiver has stored.
        self._known_to = 0 if resumed else count
        self.serial = 0
        self.resent = 0
        self.lost = 0
        self._request_base_s = request_after_s
        self._request_after_s = request_after_s
        self._received_s: float | None = None
        self._requested_at_end = -1
        self.silent_requests = 0

    @property
    def in_flight(self) -> int:
        """Number of sent chunks that are neither acknowledged nor lost."""
        return len(self._flight)

    @property
    def settled(self) -> int:
        """Number of sent chunks whose outcome is known; ``lost`` of them did not arrive."""
        return self.serial - len(self._flight)

    @property
    def complete(self) -> bool:
        """True if the receiver has reported all chunks as stored."""
        return self.stored.complete

    def next_chunk(self, now_s: float) -> tuple[int, int] | None:
        """Return (chunk, serial) to send now; None if the window is full or nothing is left to send."""
        if len(self._flight) >= self._window or self._known_to < len(self.stored):
            return None
        index = self._choose()
        if index is None:
            return None
        self.serial += 1
        if not self._flight:
            self._received_s = now_s
        self._flight[self.serial] = index
        return index, self.serial

    def _choose(self) -> int | None:
        while self._again:
            index = self._again.popleft()
            if index not in self.stored:
                self.resent += 1
                return index
        while self._next < len(self.stored):
            self._next += 1
            if self._next - 1 not in self.stored:
                return self._next - 1
        return None

    def request_due(self, now_s: float) -> tuple[int, int] | None:
        """Return (serial, from_index) of a STATUS_REQUEST to send now, otherwise None.

        The interval grows with each unanswered request.
        """
        if self.complete:
            return None
        if self._received_s is None:
            self._received_s = now_s - self._request_after_s
        if now_s - self._received_s < self._request_after_s and not self._at_the_end():
            return None
        if self._known_to >= len(self.stored) and not self._flight and (self._again or self._next < len(self.stored)):
            return None
        if self._at_the_end():
            # No further chunk follows that would trigger a report, so request one immediately instead of waiting.
            self._requested_at_end = self.serial
        else:
            longest_s = max(MAX_REQUEST_S, self._request_base_s)
            self._request_after_s = min(self._request_after_s * REQUEST_BACKOFF, longest_s)
            self.silent_requests += 1
        self._received_s = now_s
        return self.serial, self._ask_from()

    def _at_the_end(self) -> bool:
        """True if every chunk has been sent, some are unacknowledged, and no status request is outstanding."""
        return (
            bool(self._flight)
            and self._requested_at_end != self.serial
            and not self._again
            and self._next >= len(self.stored)
        )

    def _ask_from(self) -> int:
        if self._known_to < len(self.stored):
            return self._known_to
        return min(self._flight.values(), default=0)

    def on_status(self, page: StatusPage, now_s: float) -> None:
        """Process a status page; lost chunks are sent again before new ones."""
        self._received_s, self.silent_requests = now_s, 0
        self._request_after_s = self._request_base_s
        for first, last in page.ranges:
            self.stored.add_range(first, last)
        if self._known_to < len(self.stored) and page.from_index <= self._known_to:
            self._known_to = max(self._known_to, page.to_index)
            self._received_s = now_s - self._request_after_s
        # Only chunks inside the page can be recognised as lost; other chunks stay in flight until a page covers them.
        for serial in [s for s in self._flight if s <= page.serial]:
            index = self._flight[serial]
            if index in self.stored:
                del self._flight[serial]
            elif page.from_index <= index < page.to_index:
                del self._flight[serial]
                self._again.append(index)
                self.lost += 1
        for serial in [s for s, index in self._flight.items() if index in self.stored]:
            del self._flight[serial]


class ChunkReceiver:
    """Tracks the chunks received.

    ``requested_again``: number of chunks that were sent, did not arrive intact and were reported as missing. Each sent
    chunk has a separate serial and the line keeps the order, so a missing serial means a lost chunk.
    """

    def __init__(self, size: int, chunk_bytes: int, window: int, stored: Iterable[int] = ()) -> None:
        self.size, self.chunk_bytes = size, chunk_bytes
        self.stored = ChunkSet(chunk_count(size, chunk_bytes), stored)
        self._every = max(1, window // STATUS_EVERY)
        self._since = 0
        self._serial = 0
        self._arrived = 0
        self.requested_again = 0

    @property
    def settled(self) -> int:
        """Number of chunks known to have been sent; ``requested_again`` of them did not arrive intact."""
        return self._serial

    def expected_bytes(self, index: int) -> int:
        """Return the length of a chunk in bytes; 0 if it does not exist."""
        return max(0, min(self.chunk_bytes, self.size - index * self.chunk_bytes))

    def accept(self, index: int, serial: int, length: int) -> bool:
        """Record a received chunk. Returns True if it is new and complete; the caller then stores its data."""
        is_complete = 0 < length == self.expected_bytes(index)
        self._arrived += is_complete and serial > self._serial
        self._serial = max(self._serial, serial)
        self._since += 1
        return is_complete and self.stored.add(index)

    def status_due(self) -> bool:
        """True if a quarter of a window has arrived since the last STATUS, or if the transfer has become complete."""
        return self._since >= self._every or (self._since > 0 and self.stored.complete)

    def status(self, from_index: int | None = None, serial: int = 0) -> StatusPage:
        """Return the status page from the start, or from ``from_index``.

        ``serial``: serial in the status request. Because the line keeps the order, every chunk up to this serial has
        arrived or is lost.
        """
        self._serial = max(self._serial, serial)
        self.requested_again = self._serial - self._arrived
        self._since = 0
        start = self.stored.first_missing if from_index is None else min(from_index, len(self.stored))
        if from_index is None and start:
            # Include the chunks before the first gap. They form a single range, and the sender can then discard them.
            start = 0
        ranges, end = self.stored.ranges(start, PAGE_RANGES)
        return StatusPage(self._serial, self.stored.stored, start, end, ranges)

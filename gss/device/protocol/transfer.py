"""The transfer service, pure: which chunk is sent when, and who holds what. Both ends and both directions use it.

A transfer is cut into numbered chunks. The sender keeps at most a window of them on their way and gets no reply per chunk.
The receiver says now and then (STATUS) which ranges it stored and the highest ``serial`` it has seen; every chunk sent
carries the next serial. A serial line keeps order, so a chunk with a lower serial that is not stored is lost and is sent
again, and nothing else is. When STATUS stays away, the sender asks (STATUS_REQUEST).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from gss.device.dictionary import Value
from gss.device.protocol.codec import Decoded

PAGE_RANGES = 16
REQUEST_BACKOFF = 1.6
LONGEST_REQUEST_S = 3.0
ANSWER_S = 0.25
STATUS_EVERY = 4
"""A receiver reports when a window's quarter has come."""


@dataclass(frozen=True)
class Compatibility:
    """What an upload says about itself; the device refuses what it cannot use. Zeros where it does not apply (images)."""

    device_model: str = ""
    profile: str = ""
    dictionary_hash: bytes = bytes(32)
    format_version: int = 0
    epoch_jyear: float = 0.0
    stars: int = 0
    pairs: int = 0


@dataclass(frozen=True)
class StatusPage:
    """What a receiver says: from ``from_index`` to before ``to_index`` it holds exactly ``ranges`` (last inclusive)."""

    serial: int
    stored_chunks: int
    from_index: int
    to_index: int
    ranges: tuple[tuple[int, int], ...]

    def values(self, session: int) -> dict[str, Value]:
        """Fields of a STATUS message."""
        return {
            "session": session,
            "serial": self.serial,
            "stored_chunks": self.stored_chunks,
            "from_index": self.from_index,
            "to_index": self.to_index,
        }

    def lists(self) -> dict[str, list[Mapping[str, Value]]]:
        """Lists of a STATUS message."""
        return {"ranges": [{"first": first, "last": last} for first, last in self.ranges]}

    @classmethod
    def of(cls, message: Decoded) -> StatusPage:
        """From a decoded STATUS message."""
        v = {name: int(value) for name, value in message.values.items()}
        ranges = tuple((int(r["first"]), int(r["last"])) for r in message.lists["ranges"])
        return cls(v["serial"], v["stored_chunks"], v["from_index"], v["to_index"], ranges)


def chunk_count(size: int, chunk_bytes: int) -> int:
    """Chunks of a transfer of ``size`` bytes."""
    return -(-size // chunk_bytes)


def request_patience_s(window: int, chunk_bytes: int, bytes_per_s: float | None) -> float:
    """How long a sender waits for a STATUS before it asks: until one is due, and an answer's time. No rate: no line time."""
    if not bytes_per_s:
        return ANSWER_S
    return ANSWER_S + (window // STATUS_EVERY + 2) * (chunk_bytes + 64) / bytes_per_s


class ChunkSet:
    """Which of n chunks are there."""

    def __init__(self, count: int, held: Iterable[int] = ()) -> None:
        self._flags = bytearray(count)
        self.stored = 0
        self._first_missing = 0
        for index in held:
            self.add(index)

    def __len__(self) -> int:
        return len(self._flags)

    def __contains__(self, index: int) -> bool:
        return 0 <= index < len(self._flags) and self._flags[index] == 1

    @property
    def complete(self) -> bool:
        """Nothing is missing."""
        return self.stored == len(self._flags)

    @property
    def first_missing(self) -> int:
        """Lowest chunk that is not there; n where none is missing."""
        at = self._flags.find(0, self._first_missing)
        self._first_missing = len(self._flags) if at < 0 else at
        return self._first_missing

    def add(self, index: int) -> bool:
        """Mark a chunk; False if it was there or does not exist."""
        if not 0 <= index < len(self._flags) or self._flags[index]:
            return False
        self._flags[index] = 1
        self.stored += 1
        return True

    def add_range(self, first: int, last: int) -> None:
        """Mark first to last, inclusive, as far as they exist."""
        first, last = max(first, 0), min(last, len(self._flags) - 1)
        if first <= last:
            self.stored += self._flags.count(0, first, last + 1)
            self._flags[first : last + 1] = b"\1" * (last + 1 - first)

    def ranges(self, start: int = 0, limit: int | None = None) -> tuple[tuple[tuple[int, int], ...], int]:
        """Held ranges from ``start``, at most ``limit``, and the number up to which they are complete."""
        found: list[tuple[int, int]] = []
        at, count = start, len(self._flags)
        while True:
            first = self._flags.find(1, at)
            if first < 0:
                return tuple(found), count
            if limit is not None and len(found) == limit:
                return tuple(found), first
            gap = self._flags.find(0, first)
            at = count if gap < 0 else gap
            found.append((first, at - 1))

    def stored_bytes(self, size: int, chunk_bytes: int) -> int:
        """Bytes in the held chunks; the last one may be short."""
        count = len(self._flags)
        short = count * chunk_bytes - size if count and (count - 1) in self else 0
        return self.stored * chunk_bytes - short


class ChunkSender:
    """Chooses the next chunk. ``stored``: what the receiver is known to hold."""

    def __init__(self, count: int, window: int, request_after_s: float, *, resumed: bool = False) -> None:
        self.stored = ChunkSet(count)
        self._window = window
        self._flight: dict[int, int] = {}
        self._again: deque[int] = deque()
        self._next = 0
        # A resumed transfer first learns all pages of what the other side holds.
        self._known_to = 0 if resumed else count
        self.serial = 0
        self.resent = 0
        self.lost = 0
        self._request_base_s = request_after_s
        self._request_after_s = request_after_s
        self._heard_s: float | None = None
        self._asked_at_end = -1
        self.silent_requests = 0

    @property
    def in_flight(self) -> int:
        """Chunks on their way."""
        return len(self._flight)

    @property
    def settled(self) -> int:
        """Sent chunks whose fate is known; ``lost`` of them did not arrive."""
        return self.serial - len(self._flight)

    @property
    def complete(self) -> bool:
        """The receiver said that it holds all."""
        return self.stored.complete

    def next_chunk(self, now_s: float) -> tuple[int, int] | None:
        """(chunk, serial) to send now; None if the window is full or nothing is left to send."""
        if len(self._flight) >= self._window or self._known_to < len(self.stored):
            return None
        index = self._choose()
        if index is None:
            return None
        self.serial += 1
        if not self._flight:
            self._heard_s = now_s
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
        """(serial, from_index) of a STATUS_REQUEST to send now, with growing patience."""
        if self.complete:
            return None
        if self._heard_s is None:
            self._heard_s = now_s - self._request_after_s
        if now_s - self._heard_s < self._request_after_s and not self._at_the_end():
            return None
        if self._known_to >= len(self.stored) and not self._flight and (self._again or self._next < len(self.stored)):
            return None
        if self._at_the_end():
            # Nothing follows that would make the receiver report: ask at once instead of waiting for its silence.
            self._asked_at_end = self.serial
        else:
            longest_s = max(LONGEST_REQUEST_S, self._request_base_s)
            self._request_after_s = min(self._request_after_s * REQUEST_BACKOFF, longest_s)
            self.silent_requests += 1
        self._heard_s = now_s
        return self.serial, self._ask_from()

    def _at_the_end(self) -> bool:
        """Has all been sent, some without a word of it, and nobody been asked since?"""
        return (
            bool(self._flight)
            and self._asked_at_end != self.serial
            and not self._again
            and self._next >= len(self.stored)
        )

    def _ask_from(self) -> int:
        if self._known_to < len(self.stored):
            return self._known_to
        return min(self._flight.values(), default=0)

    def on_status(self, page: StatusPage, now_s: float) -> None:
        """Learn what arrived; what is lost goes to the front of what is to be sent."""
        self._heard_s, self.silent_requests = now_s, 0
        self._request_after_s = self._request_base_s
        for first, last in page.ranges:
            self.stored.add_range(first, last)
        if self._known_to < len(self.stored) and page.from_index <= self._known_to:
            self._known_to = max(self._known_to, page.to_index)
            self._heard_s = now_s - self._request_after_s
        # Everything below the page is held: pages start at the receiver's first gap unless another start was asked for.
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
    """Keeps what arrived. ``asked_again``: chunks that were sent, did not arrive whole and were told as missing: each
    chunk sent has its own serial and the line keeps order, so what is missing among the serials was lost."""

    def __init__(self, size: int, chunk_bytes: int, window: int, held: Iterable[int] = ()) -> None:
        self.size, self.chunk_bytes = size, chunk_bytes
        self.held = ChunkSet(chunk_count(size, chunk_bytes), held)
        self._every = max(1, window // STATUS_EVERY)
        self._since = 0
        self._serial = 0
        self._arrived = 0
        self.asked_again = 0

    @property
    def settled(self) -> int:
        """Chunks that were sent as far as is known; ``asked_again`` of them did not arrive whole."""
        return self._serial

    def expected_bytes(self, index: int) -> int:
        """Length of a chunk; 0 for one that does not exist."""
        return max(0, min(self.chunk_bytes, self.size - index * self.chunk_bytes))

    def accept(self, index: int, serial: int, length: int) -> bool:
        """Is this chunk new and whole? Then the owner stores it."""
        whole = 0 < length == self.expected_bytes(index)
        self._arrived += whole and serial > self._serial
        self._serial = max(self._serial, serial)
        self._since += 1
        return whole and self.held.add(index)

    def status_due(self) -> bool:
        """Some chunks came since the last STATUS, or the last one came."""
        return self._since >= self._every or (self._since > 0 and self.held.complete)

    def status(self, from_index: int | None = None, serial: int = 0) -> StatusPage:
        """A page from the first gap (or where asked). ``serial``: of the request that asks; order on the line makes it final."""
        self._serial = max(self._serial, serial)
        self.asked_again = self._serial - self._arrived
        self._since = 0
        start = self.held.first_missing if from_index is None else min(from_index, len(self.held))
        if from_index is None and start:
            # The run before the first gap is one range: it costs nothing and lets the sender forget it.
            start = 0
        ranges, end = self.held.ranges(start, PAGE_RANGES)
        return StatusPage(self._serial, self.held.stored, start, end, ranges)

"""Rollups: minimum and maximum of each field for each interval of ten seconds, with the times of both. A plot of a week
then reads only a few hundred rows and still shows every spike. A background thread computes the rollup of each hour
after the hour has ended."""

from __future__ import annotations

import logging
import threading
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.errors import GssError
from gss.instruments.dictionary.definitions import Group, Item, PacketDefinition
from gss.operations.clock import Now
from gss.operations.telemetry.field_definitions import TelemetryDefinitions
from gss.operations.telemetry.value_format import kind, number
from gss.store import rollups as store
from gss.store.engine import Database
from gss.store.rollups import HOUR_S

Array = NDArray[np.float64]
log = logging.getLogger(__name__)
PLOTTED = ("number", "enum", "bool")
BUCKET_S = 10
SETTLE_S = 60.0
"""Delay in seconds after which an ended hour counts as complete."""
LOOK_S = 60.0
SLICE = timedelta(minutes=1)
"""Span whose packets are read together, a multiple of ``BUCKET_S``. An hour of 50 packets/s would need more than 600 MiB."""
HOURS_AT_ONCE = 400
"""Maximum number of hours computed per pass. A store with a long history needs several passes."""
MOMENT = timedelta(microseconds=1)
"""Resolution of a stored time."""
EARLIEST = datetime(1970, 1, 2, tzinfo=UTC)


@dataclass(frozen=True)
class Buckets:
    """Ten-second spans that have packets, in time order. All arrays are (n,). ``count``: number of packets, with or
    without the value; ``low_s``, ``low``, ``high_s``, ``high``: Unix seconds and value of the minimum and maximum, NaN
    if no packet of the span has the value."""

    count: NDArray[np.int64]
    low_s: Array
    low: Array
    high_s: Array
    high: Array

    def __len__(self) -> int:
        return len(self.count)

    def packed(self, hour: int) -> bytes:
        """Encode the buckets for storage: one column after the other, with times relative to the start of the hour."""
        start_s = hour * HOUR_S
        columns = (self.low_s - start_s, self.low, self.high_s - start_s, self.high)
        body = b"".join([self.count.astype("<u4").tobytes(), *(c.astype("<f8").tobytes() for c in columns)])
        return zlib.compress(body, 1)

    @classmethod
    def unpacked(cls, hour: int, data: bytes) -> Buckets:
        """Decode the bytes from :meth:`packed`."""
        body = zlib.decompress(data)
        n = len(body) // 36
        count = np.frombuffer(body, "<u4", n).astype(np.int64)
        low_s, low, high_s, high = np.frombuffer(body, "<f8", 4 * n, 4 * n).reshape(4, n)
        return cls(count, low_s + hour * HOUR_S, low, high_s + hour * HOUR_S, high)

    def of_row(self, k: int) -> Buckets:
        """Return the buckets of field ``k`` of those of several fields."""
        return Buckets(self.count, self.low_s[k], self.low[k], self.high_s[k], self.high[k])

    @classmethod
    def joined(cls, parts: Sequence[Buckets]) -> Buckets:
        """Concatenate the buckets of several parts."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))


@dataclass(frozen=True)
class RollupHours:
    """Consecutive hours, from ``first`` to ``last`` inclusive, with the buckets of each field."""

    first: int
    last: int
    of: Mapping[str, Buckets]


def buckets(t_s: Array, y: Array) -> Buckets:
    """Compute the buckets of n samples in time order. ``y``: values of one field (n) or of several (fields, n), NaN for packets
    without the value."""
    numbers = np.floor_divide(t_s, BUCKET_S).astype(np.int64)
    starts = np.flatnonzero(np.concatenate([[True], numbers[1:] != numbers[:-1]]))
    count = np.diff(np.append(starts, len(t_s)))
    low_at, low = _first_extreme(np.where(np.isnan(y), np.inf, y), np.minimum, starts, count)
    high_at, high = _first_extreme(np.where(np.isnan(y), -np.inf, y), np.maximum, starts, count)
    empty = np.isinf(low)
    return Buckets(count, t_s[low_at], np.where(empty, np.nan, low), t_s[high_at], np.where(empty, np.nan, high))


def _first_extreme(y: Array, extreme: np.ufunc, starts: NDArray[np.intp], count: NDArray[Any]) -> tuple[Any, Array]:
    """Return the index of the first occurrence of each bucket's extreme, and the extreme."""
    extremes = extreme.reduceat(y, starts, axis=-1)
    index = np.where(y == np.repeat(extremes, count, axis=-1), np.arange(y.shape[-1]), y.shape[-1])
    return np.minimum.reduceat(index, starts, axis=-1), extremes


class Rollups:
    """Computes rollups in the background and reads them for plots."""

    def __init__(self, dictionary: TelemetryDefinitions, database: Database, now: Now) -> None:
        self._dictionary, self._database, self._now = dictionary, database, now
        self._packets_read: tuple[PacketDefinition, ...] = ()
        self._plotted: dict[str, list[Item]] = {}
        self._newest: dict[str, int | None] = {}
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def _fields(self) -> Mapping[str, list[Item]]:
        """Fields that can be plotted, by packet. Packets without such fields are omitted."""
        packets = self._dictionary.telemetry
        if packets != self._packets_read:
            fields = {p.name: [f for f in p.fields if not isinstance(f, Group) and kind(f) in PLOTTED] for p in packets}
            self._packets_read, self._plotted = packets, {name: plotted for name, plotted in fields.items() if plotted}
        return self._plotted

    def start(self) -> None:
        """Start the background thread."""
        self._thread = threading.Thread(target=self._run, name="rollups", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop after the hour in progress."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(LOOK_S):
            try:
                self.make()
            except GssError:  # other services report a full disk or locked database; plots read packets until then
                log.warning("rollups could not be computed; they are tried again", exc_info=True)

    def make(self, max_hours: int = HOURS_AT_ONCE) -> int:
        """Compute missing hours, oldest first. Return the number of hours computed."""
        count, end_hour = 0, store.hour_of(self._now() - timedelta(seconds=SETTLE_S))
        for packet in list(self._fields):
            for hour in self._missing(packet, end_hour):
                if count >= max_hours or self._ended.is_set():
                    return count
                count += self._make_hour(packet, hour)
        return count

    def _missing(self, packet: str, end_hour: int) -> Iterator[int]:
        """Yield the hours before ``end_hour`` that have packets but no rollup. A gap without packets costs one index
        lookup, however long it is."""
        with self._database.unit_of_work() as session:
            done_hours = store.done_hours(session, packet, 0, end_hour)
        self._newest[packet] = done_hours[-1] if done_hours else None
        ends = {run[0]: run[-1] for run in _consecutive(done_hours)}
        at = EARLIEST
        while True:
            with self._database.unit_of_work() as session:
                next_packet = store.next_received(session, packet, at)
            if next_packet is None or (hour := store.hour_of(next_packet)) >= end_hour:
                return
            run = max((first for first in ends if first <= hour), default=None)
            if run is not None and hour <= ends[run]:
                hour = ends[run]
            else:
                yield hour
            at = store.start_of(hour + 1)

    def _make_hour(self, packet: str, hour: int) -> bool:
        plotted = self._fields.get(packet, ())
        parts: dict[str, list[Buckets]] = {item.name: [] for item in plotted}
        read, start, end = 0, store.start_of(hour), store.start_of(hour + 1)
        while start < end:
            with self._database.unit_of_work() as session:
                rows = store.packets_of(session, packet, start, start + SLICE)
            start += SLICE
            read += len(rows)
            if not (rows and plotted):  # a new dictionary can lack the packet
                continue
            t_s = np.array([at.timestamp() for at, _ in rows])
            y = np.array([[number(item, row.get(item.name)) for _, row in rows] for item in plotted], np.float64)
            of_fields = buckets(t_s, y)
            for k, item in enumerate(plotted):
                parts[item.name].append(of_fields.of_row(k))
        data = {name: Buckets.joined(of_slices).packed(hour) for name, of_slices in parts.items() if of_slices}
        with self._database.unit_of_work() as session:
            rollup = store.keep(session, packet, hour, data, read)
        if rollup:
            self._newest[packet] = max(hour, self._newest.get(packet) or hour)
        return rollup

    def wrote(self, session: Any, packets: Sequence[str], at: datetime) -> None:
        """Remove the rollup of an hour in which packets are stored late, for example after the clock was set back.
        Plots then read the packets of this hour. Called in the transaction that stores packets received at ``at``."""
        hour = store.hour_of(at)
        late = [
            name for name in dict.fromkeys(packets) if name in self._fields and hour <= self._newest_of(session, name)
        ]
        if late:
            store.undo(session, late, hour)

    def _newest_of(self, session: Any, packet: str) -> int:
        if packet not in self._newest:
            self._newest[packet] = store.newest_hour(session, packet)
        newest = self._newest[packet]
        return -1 if newest is None else newest

    def read(self, packet: str, names: Sequence[str], start: datetime, end: datetime) -> list[RollupHours]:
        """Return the rollups of the hours that lie completely within a time span, in time order."""
        first, last = store.hour_of(start - MOMENT) + 1, store.hour_of(end) - 1
        parts: dict[int, dict[str, bytes]] = {}
        with self._database.unit_of_work() as session:
            done_hours = store.done_hours(session, packet, first, last)
            for hour, name, data in store.of_fields(session, packet, names, first, last) if done_hours else ():
                parts.setdefault(hour, {})[name] = data
        # If the dictionary lacked a field when an hour was rolled up, that hour is read from packets instead.
        complete_hours = [hour for hour in done_hours if len(parts.get(hour, ())) == len(names)]
        return [
            RollupHours(
                run[0],
                run[-1],
                {name: Buckets.joined([Buckets.unpacked(hour, parts[hour][name]) for hour in run]) for name in names},
            )
            for run in _consecutive(complete_hours)
        ]


def _consecutive(hours: Sequence[int]) -> list[list[int]]:
    runs: list[list[int]] = []
    for hour in hours:
        if runs and runs[-1][-1] == hour - 1:
            runs[-1].append(hour)
        else:
            runs.append([hour])
    return runs

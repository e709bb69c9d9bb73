"""The telemetry archive: reads any field over any time span in bounded memory, completely or decimated for a plot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from gss.domain.errors import BadInput, NotFound
from gss.instruments.dictionary.definitions import Group, Item, PacketDefinition, TelemetryField
from gss.operations.telemetry.derived import DerivedParameters
from gss.operations.telemetry.rollups import BUCKET_S, MOMENT, PLOTTED, Buckets, RollupHours, Rollups
from gss.operations.telemetry.value_format import kind, number
from gss.store import telemetry as store
from gss.store.engine import Database
from gss.store.models import TelemetryPacket
from gss.store.rollups import start_of


@dataclass(frozen=True)
class Column:
    """A requested field: ``key`` is ``name`` or ``packet.name``. A list in a packet (Group) is also a column."""

    key: str
    packet: str
    field: Item | Group


@dataclass(frozen=True)
class TelemetrySeries:
    """Values of a field over a time span. ``t``: Unix seconds; ``y``: values; ``samples``: number of samples in the
    span; ``thinned``: True if only some of the samples are included; ``resolution_s``: see ``Thinner``."""

    key: str
    packet: str
    definition: TelemetryField
    t: list[float]
    y: list[float | None]
    samples: int
    thinned: bool
    resolution_s: float


@dataclass
class Thinner:
    """Decimates samples, which must be added in time order, to at most ``points``. If there are more samples, it keeps
    only the minimum and maximum of each of points // 2 equal parts of the span. Memory: O(points)."""

    start_s: float
    end_s: float
    points: int
    samples: int = 0
    _all_samples: list[tuple[float, float | None]] | None = field(default_factory=list)
    _bins: dict[int, tuple[tuple[float, float | None], tuple[float, float | None]]] = field(default_factory=dict)
    _bucket_s: float = 0.0

    @property
    def resolution_s(self) -> float:
        """Return 0 if all samples are included. Otherwise: if the samples are at most this time apart, which is a part of
        the span and the length of a bucket, the times of the result are less than twice this time apart."""
        if self._all_samples is not None:
            return 0.0
        return (self.end_s - self.start_s) / max(1, self.points // 2) + self._bucket_s

    def take(self, t: float, y: float | None) -> None:
        """Add one sample."""
        self.samples += 1
        if self._all_samples is not None:
            self._all_samples.append((t, y))
            if len(self._all_samples) > self.points:
                samples, self._all_samples = self._all_samples, None
                for sample in samples:
                    self._bin(*sample)
        else:
            self._bin(t, y)

    def merge(self, buckets: Buckets) -> None:
        """Add samples as buckets, which contain only the extremes of each ten seconds."""
        self.samples += int(buckets.count.sum())
        self._bucket_s = float(BUCKET_S)
        if self._all_samples is not None:
            samples, self._all_samples = self._all_samples, None
            for sample in samples:
                self._bin(*sample)
        bins = max(1, self.points // 2)
        # The extremes are sorted by time, so that a bucket on the edge of two bins adds each extreme to the bin that contains
        # it.
        t = np.concatenate([buckets.low_s, buckets.high_s])
        y = np.concatenate([buckets.low, buckets.high])
        order = np.argsort(t, kind="stable")
        t, y = t[order], y[order]
        part = (t - self.start_s) / max(self.end_s - self.start_s, 1e-9)
        edges = np.searchsorted(np.clip((part * bins).astype(np.int64), 0, bins - 1), np.arange(bins + 1))
        for b in np.flatnonzero(np.diff(edges)):
            bin_t, bin_y = t[edges[b] : edges[b + 1]], y[edges[b] : edges[b + 1]]
            if np.isnan(bin_y).all():
                self._bin(float(bin_t[0]), None)
                continue
            for k in sorted({int(np.nanargmin(bin_y)), int(np.nanargmax(bin_y))}):
                self._bin(float(bin_t[k]), float(bin_y[k]))

    def _bin(self, t: float, y: float | None) -> None:
        bins = max(1, self.points // 2)
        part = (t - self.start_s) / max(self.end_s - self.start_s, 1e-9)
        b = min(bins - 1, max(0, int(part * bins)))
        stored_bin = self._bins.get(b)
        if stored_bin is None or (stored_bin[0][1] is None and y is not None):
            self._bins[b] = ((t, y), (t, y))
        elif y is not None:
            low, high = stored_bin
            if y < low[1]:  # type: ignore[operator]  # y is a number, so the stored value is also a number (see above)
                low = (t, y)
            if y > high[1]:  # type: ignore[operator]  # as above
                high = (t, y)
            self._bins[b] = (low, high)

    def result(self) -> tuple[list[float], list[float | None], bool]:
        """Return (t, y, thinned), in time order."""
        if self._all_samples is not None:
            return [t for t, _ in self._all_samples], [y for _, y in self._all_samples], False
        samples = [sample for b in sorted(self._bins) for sample in sorted(set(self._bins[b]), key=lambda s: s[0])]
        return [t for t, _ in samples], [y for _, y in samples], True


class Archive:
    """Answers queries about past telemetry."""

    def __init__(self, dictionary: DerivedParameters, database: Database, rollups: Rollups) -> None:
        self.dictionary, self.database, self._rollups = dictionary, database, rollups

    def column(self, key: str) -> Column:
        """Return the field for a key ``name`` or ``packet.name``. A key without a packet selects the first packet that
        contains the field, housekeeping first. Raises NotFound."""
        packet_name, _, name = key.rpartition(".")
        packets: Sequence[PacketDefinition] = (
            [self.dictionary.stored_packet(packet_name)] if packet_name else [*self.dictionary.telemetry]
        )
        for packet in packets:
            for item in packet.fields:
                if item.name == name and (packet_name or not isinstance(item, Group)):
                    return Column(key, packet.name, item)
        raise NotFound("unknown telemetry field", got=key, hint="see the dictionary")

    def history(self, keys: Sequence[str], start: datetime, end: datetime, points: int) -> list[TelemetrySeries]:
        """Return each field over a span, decimated to at most ``points`` samples without loss of spikes. Enumerations
        are returned as their numbers, and yes is returned as 1. Raises BadInput for fields that cannot be plotted."""
        columns = self._checked(keys, start, end)
        for column in columns:
            if isinstance(column.field, Group) or kind(column.field) not in PLOTTED:
                raise BadInput("only numbers, choices and yes/no values can be plotted", got=column.key)
        series: dict[str, TelemetrySeries] = {}
        for packet in dict.fromkeys(c.packet for c in columns):
            of_packet = [c for c in columns if c.packet == packet]
            fields = [c.field for c in of_packet if isinstance(c.field, TelemetryField)]
            thinners = self._thinned(packet, fields, start, end, points)
            for column, thinner, definition in zip(of_packet, thinners, fields, strict=True):
                t_s, y, thinned = thinner.result()
                series[column.key] = TelemetrySeries(
                    column.key, packet, definition, t_s, y, thinner.samples, thinned, thinner.resolution_s
                )
        return [series[key] for key in keys]

    def _thinned(
        self, packet: str, fields: Sequence[TelemetryField], start: datetime, end: datetime, points: int
    ) -> list[Thinner]:
        """Return the decimated fields, from rollups if these are fine enough for the plot, otherwise from packets.
        Rollups are also used if retention removed or thinned the packets, because the rollups then contain more
        samples."""
        stretches = self._rollups.read(packet, [f.name for f in fields], start, end)
        sample_count = sum(int(stretch.of[fields[0].name].count.sum()) for stretch in stretches)
        coarse = (end - start).total_seconds() / max(1, points // 2) >= 2 * BUCKET_S
        if not coarse or sample_count <= points:
            thinners = self._from_packets(packet, fields, start, end, points)
            if thinners[0].samples >= sample_count:
                return thinners
        return self._from_rollups(packet, fields, stretches, start, end, points)

    def _from_packets(
        self, packet: str, fields: Sequence[TelemetryField], start: datetime, end: datetime, points: int
    ) -> list[Thinner]:
        thinners = [Thinner(start.timestamp(), end.timestamp(), points) for _ in fields]
        self._take_packets(packet, fields, start, end, thinners)
        return thinners

    def _from_rollups(
        self,
        packet: str,
        fields: Sequence[TelemetryField],
        stretches: Sequence[RollupHours],
        start: datetime,
        end: datetime,
        points: int,
    ) -> list[Thinner]:
        """Return the decimated fields, from rollups for the hours that have a rollup and from packets for the remaining
        time."""
        thinners, position = [Thinner(start.timestamp(), end.timestamp(), points) for _ in fields], start
        for stretch in stretches:
            self._take_packets(packet, fields, position, start_of(stretch.first) - MOMENT, thinners)
            for thinner, definition in zip(thinners, fields, strict=True):
                thinner.merge(stretch.of[definition.name])
            position = start_of(stretch.last + 1)
        self._take_packets(packet, fields, position, end, thinners)
        return thinners

    def _take_packets(
        self,
        packet: str,
        fields: Sequence[TelemetryField],
        start: datetime,
        end: datetime,
        thinners: Sequence[Thinner],
    ) -> None:
        if end < start:
            return
        for row in store.rows(self.database, packet, [f.name for f in fields], start, end):
            t = row.received.timestamp()
            for thinner, definition, value in zip(thinners, fields, row.values, strict=True):
                thinner.take(t, number(definition, value))

    def rows(
        self, keys: Sequence[str], start: datetime, end: datetime
    ) -> tuple[list[Column], Iterator[tuple[store.Row, list[object]]]]:
        """Return the columns, and an iterator of (row, a value per column) over the packets that contain a column,
        oldest first."""
        columns = self._checked(keys, start, end)
        return columns, self._merged(columns, start, end)

    def _merged(
        self, columns: Sequence[Column], start: datetime, end: datetime
    ) -> Iterator[tuple[store.Row, list[object]]]:
        import heapq

        columns_of: dict[str, list[int]] = {}
        for k, column in enumerate(columns):
            columns_of.setdefault(column.packet, []).append(k)
        streams = [
            store.rows(self.database, packet, [columns[k].field.name for k in indices], start, end)
            for packet, indices in columns_of.items()
        ]
        for row in heapq.merge(*streams, key=lambda r: (r.received, r.id)):
            values: list[object] = [None] * len(columns)
            for k, value in zip(columns_of[row.packet], row.values, strict=True):
                values[k] = value
            yield row, values

    def _checked(self, keys: Sequence[str], start: datetime, end: datetime) -> list[Column]:
        if end <= start:
            raise BadInput("the time span is empty", expected="a start before the end", got=f"{start} … {end}")
        if len(set(keys)) != len(keys) or not keys:
            raise BadInput("no field is given, or a field is given twice", got=", ".join(keys) or "none")
        return [self.column(key) for key in keys]

    def packets(
        self,
        packet: str | None,
        start: datetime | None,
        end: datetime | None,
        limit: int,
        before_id: int | None,
        contact_id: int | None = None,
        after_id: int | None = None,
    ) -> list[TelemetryPacket]:
        """Return a page of stored packets, latest first; with ``after_id``, the packets that follow this packet, oldest
        first."""
        if packet is not None:
            self.dictionary.stored_packet(packet)
        with self.database.unit_of_work() as session:
            return store.page(session, packet, start, end, limit, before_id, contact_id, after_id)

"""Plots of long spans from rollups equal plots from packets, on every database."""

from __future__ import annotations

import random
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import delete, event

from gss.device.session_events import Telemetry
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.events import EventBus
from gss.operations.line.line_events import LineBatch
from gss.operations.telemetry.archive import Thinner
from gss.operations.telemetry.rollups import Buckets, buckets
from gss.operations.telemetry.telemetry import TelemetryService
from gss.store import telemetry as store
from gss.store.engine import Database
from gss.store.models import TelemetryPacket

T0 = datetime(2026, 12, 1, tzinfo=UTC)
HOURS = 6
MODES = ("standby", "lost_in_space", "tracking")


def values(k: int) -> dict[str, object]:
    """Return the housekeeping values of second ``k``: noise, two spikes of one second, and a period without a value."""
    noise = random.Random(k).gauss(0, 0.01)
    spike = {4321: 2.5, 15_001: -2.5}.get(k, 0.0)
    fields: dict[str, object] = {"latchups": k // 5000, "mode": MODES[k // 700 % 3], "cycle_running": k % 900 < 450}
    return fields if 8000 <= k < 9500 else fields | {"supply_3v3_v": 3.3 + noise + spike}


class ManualClock:
    """Clock that the test sets."""

    def __init__(self) -> None:
        self.at = T0

    def __call__(self) -> datetime:
        return self.at


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def telemetry(database: Database, clock: ManualClock) -> TelemetryService:
    """Service with six hours of housekeeping, every sixth second, with a gap of twenty minutes."""
    service = TelemetryService(
        load_dictionary(),
        database,
        EventBus(database, clock),
        clock,
        lambda: None,
        lambda: True,
        default_roles(load_dictionary()).quantities.status,
    )
    seconds = [k for k in range(0, HOURS * 3600, 6) if not 12_000 <= k < 13_200]
    times = [(k, T0 + timedelta(seconds=k, microseconds=7 * k)) for k in seconds]
    times += [(k, T0 + timedelta(seconds=k, milliseconds=1)) for k in (4321, 15_001)]
    shared = {"packet": "housekeeping", "request_id": 0}
    with database.unit_of_work() as session:
        store.add_many(
            session,
            [
                {**shared, "received": at, "device_time_s": float(k), "values": values(k)}
                for k, at in sorted(times, key=lambda row: row[1])
            ],
        )
    return service


NAMES = ["supply_3v3_v", "mode", "cycle_running", "latchups"]
Plot = Callable[[], list[tuple[list[float], list[float | None], int]]]


def plotted(telemetry: TelemetryService, start: datetime, end: datetime, points: int) -> list[object]:
    """Return the series of a plot."""
    series = telemetry.archive.history(NAMES, start, end, points)
    return [(s.t, s.y, s.samples, s.thinned) for s in series]


def test_a_plot_from_rollups_equals_the_plot_from_packets(telemetry: TelemetryService, clock: ManualClock) -> None:
    """If bins are multiples of ten seconds, rollups give exactly the same points as packets, including spikes and gaps.
    Packets are read only for the ends of the span.
    """
    spans = [(T0, T0 + timedelta(hours=HOURS)), (T0 + timedelta(seconds=1230), T0 + timedelta(hours=5, seconds=1230))]
    before = [plotted(telemetry, *span, 240) for span in spans]
    clock.at = T0 + timedelta(hours=HOURS, seconds=61)
    assert telemetry.rollups.make() == HOURS
    assert telemetry.rollups.make() == 0
    read: list[str] = []
    engine = telemetry.archive.database.engine
    event.listen(engine, "before_cursor_execute", lambda *a: read.append(a[2]))
    assert [plotted(telemetry, *span, 240) for span in spans] == before
    supply = before[0][0][1]
    assert max(v for v in supply if v is not None) > 5.5
    assert min(v for v in supply if v is not None) < 1.0
    # The first span has two empty ends, the second two ends of some minutes. No block of packets between them is read.
    assert sum("FROM telemetry_packets" in statement for statement in read) <= 4


def test_short_spans_and_few_samples_are_read_from_packets(telemetry: TelemetryService, clock: ManualClock) -> None:
    """A plot that is finer than the rollups, or has room for every sample, contains all samples."""
    clock.at = T0 + timedelta(hours=HOURS, seconds=61)
    telemetry.rollups.make()
    (short, *_) = telemetry.archive.history(NAMES, T0, T0 + timedelta(seconds=2999), 2000)
    assert (short.samples, short.thinned, len(short.t)) == (500, False, 500)
    (full_span, *_) = telemetry.archive.history(NAMES, T0, T0 + timedelta(hours=HOURS), 20_000)
    assert full_span.samples == len(full_span.t)
    assert not full_span.thinned


def test_late_packets_are_in_the_plot(telemetry: TelemetryService, clock: ManualClock) -> None:
    """Packets stored in a completed hour, after the clock was set back, are in the plot, and the rollup is rebuilt."""
    clock.at = T0 + timedelta(hours=HOURS, seconds=61)
    telemetry.rollups.make()
    clock.at = T0 + timedelta(hours=2, seconds=1000.5)
    fields = {"supply_3v3_v": 9.9}
    telemetry.handle(LineBatch((Telemetry("housekeeping", 1.0, 0, fields, fields),), clock(), 0.0))
    span = (T0, T0 + timedelta(hours=HOURS))
    (supply, *_) = telemetry.archive.history(NAMES, *span, 240)
    assert 9.9 in supply.y
    clock.at = T0 + timedelta(hours=HOURS, seconds=61)
    assert telemetry.rollups.make() == 1
    assert telemetry.archive.history(NAMES, *span, 240)[0] == supply


def test_the_current_hour_has_no_rollup(telemetry: TelemetryService, clock: ManualClock) -> None:
    """A rollup is built only for hours that ended at least a minute ago."""
    clock.at = T0 + timedelta(hours=3, seconds=59)
    assert telemetry.rollups.make() == 2
    clock.at = T0 + timedelta(hours=3, seconds=61)
    assert telemetry.rollups.make() == 1


def test_rollups_outlive_their_packets(telemetry: TelemetryService, clock: ManualClock) -> None:
    """After retention has removed packets, the plot from rollups is unchanged."""
    span = (T0, T0 + timedelta(hours=HOURS))
    before = plotted(telemetry, *span, 240)
    clock.at = T0 + timedelta(hours=HOURS, seconds=61)
    telemetry.rollups.make()
    with telemetry.archive.database.unit_of_work() as session:
        session.execute(delete(TelemetryPacket).where(TelemetryPacket.id % 20 != 0))
    assert plotted(telemetry, *span, 240) == before
    with telemetry.archive.database.unit_of_work() as session:
        session.execute(delete(TelemetryPacket))
    assert plotted(telemetry, *span, 240) == before
    assert telemetry.rollups.make() == 0


samples = st.lists(st.tuples(st.floats(0, 50), st.one_of(st.none(), st.floats(-1e3, 1e3))), min_size=1, max_size=200)


@given(samples, st.integers(4, 40))
def test_buckets_lose_no_extreme(given_samples: list[tuple[float, float | None]], points: int) -> None:
    """Packed buckets have the count and the first smallest and largest value of each ten seconds, with their times. A plot
    of them has the smallest and largest value of all."""
    t_s, y = np.cumsum([gap for gap, _ in given_samples]), [v for _, v in given_samples]
    numbers = np.array([np.nan if v is None else v for v in y])
    packed_buckets = Buckets.unpacked(0, buckets(t_s, numbers).packed(0))
    assert packed_buckets.count.sum() == len(y)
    for k, number in enumerate(dict.fromkeys((t_s // 10).tolist())):
        bucket_samples = [(t, v) for t, v in zip(t_s.tolist(), y, strict=True) if t // 10 == number and v is not None]
        if not bucket_samples:
            assert np.isnan(packed_buckets.low[k])
            continue
        low, high = min(bucket_samples, key=lambda s: s[1]), max(bucket_samples, key=lambda s: s[1])
        assert (packed_buckets.low_s[k], packed_buckets.low[k], packed_buckets.high_s[k], packed_buckets.high[k]) == (
            *low,
            *high,
        )
    thinner = Thinner(0.0, float(t_s[-1]) + 1, points)
    thinner.merge(packed_buckets)
    t, plot_values, _ = thinner.result()
    assert len(t) <= points
    assert t == sorted(t)
    numbers_given = [v for v in y if v is not None]
    if numbers_given:
        plotted_values = [v for v in plot_values if v is not None]
        assert (min(plotted_values), max(plotted_values)) == (min(numbers_given), max(numbers_given))

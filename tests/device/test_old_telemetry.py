"""Recorded telemetry that is replayed on the line is not used as current."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gss.device.protocol.packet import Arrival
from gss.device.session_events import LinkCounters

if TYPE_CHECKING:
    from conftest import Bench


def test_replayed_housekeeping_is_marked_and_counted(bench: Bench) -> None:
    """Packets that were recorded 20 minutes earlier are marked as repeated and counted. They do not change the current
    housekeeping or the gap counter."""
    recorded: list[bytes] = []
    feed = bench.host.feed
    bench.host.feed = lambda data, now_s: recorded.append(data) or feed(data, now_s)  # type: ignore[method-assign]
    bench.run(3.0)
    bench.host.feed = feed  # type: ignore[method-assign]
    bench.run(1200.0)
    newest = bench.host.housekeeping
    bench.events.clear()
    bench.events += bench.host.feed(b"\0".join(recorded), bench.now_s)
    assert {p.arrival for p in bench.telemetry("housekeeping")} == {Arrival.REPEATED}
    assert bench.host.housekeeping is newest
    bench.run(3.0)
    assert bench.telemetry("housekeeping")[-1].arrival is Arrival.CURRENT
    counters = [e for e in bench.events if isinstance(e, LinkCounters)][-1].received
    assert counters.gaps == 0
    assert counters.duplicates >= 3


def test_telemetry_after_a_reset_is_current(bench: Bench) -> None:
    """Telemetry after a reset, which restarts the device's counters, is marked as current."""
    bench.do("RESET")
    bench.events.clear()
    bench.run(5.0)
    assert {p.arrival for p in bench.telemetry("housekeeping")} == {Arrival.CURRENT}

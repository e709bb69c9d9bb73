"""Housekeeping of a simulator whose process was paused, as on a busy machine."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from gss.device.simulator.machine import MAX_OVERDUE

if TYPE_CHECKING:
    from conftest import Bench


def test_a_pause_of_the_process_loses_no_housekeeping(bench: Bench) -> None:
    """After a pause of five seconds, there is a packet for every second, with the time at which it was due."""
    bench.run(3.0)
    bench.now_s += 5.0
    bench.run(3.0)
    times = [e.device_time_s for e in bench.telemetry("housekeeping")]
    assert len(times) >= 10
    assert all(abs(b - a - 1.0) < 0.1 for a, b in itertools.pairwise(times))


def test_after_a_long_pause_the_number_of_late_packets_is_limited(bench: Bench) -> None:
    """After a pause of one day, the simulator sends a bounded number of late packets and then one per second."""
    bench.run(3.0)
    before = len(bench.telemetry("housekeeping"))
    bench.now_s += 86_400.0
    bench.run(3.0)
    times = [e.device_time_s for e in bench.telemetry("housekeeping")]
    assert MAX_OVERDUE <= len(times) - before <= MAX_OVERDUE + 4
    assert all(abs(b - a - 1.0) < 0.1 for a, b in itertools.pairwise(times[-5:]))

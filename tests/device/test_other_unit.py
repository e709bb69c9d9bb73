"""Another unit answers on the line: nothing that was meant for the one before reaches it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from gss.device.session_events import Stage
from gss.device.simulator.machine import Identity
from gss.domain.errors import NotFound

if TYPE_CHECKING:
    from conftest import Bench


def test_nothing_is_sent_before_somebody_has_answered(bench: Bench) -> None:
    """After the line was lost and came back a queued command waits for HELLO, then goes out to the same unit."""
    bench.until(lambda: bench.host.hello is not None)
    bench.host.link_lost(bench.now_s)
    waiting = bench.host.submit("SET_EXPOSURE", {"exposure_ms": 123}, bench.now_s)
    bench.host.link_up(bench.now_s)
    out, events = bench.host.poll(bench.now_s)
    bench.events += events
    bench._up += out
    assert bench.stage(waiting) is Stage.QUEUED
    bench.until(lambda: bench.stage(waiting) is Stage.COMPLETED)


def test_queued_and_unknown_commands_do_not_reach_another_unit(bench: Bench) -> None:
    """The queue is withdrawn with the names of both units, and an unknown command can no longer be retried."""
    bench.until(lambda: bench.host.hello is not None)
    lost = bench.host.submit("SET_EXPOSURE", {"exposure_ms": 111}, bench.now_s)
    bench.connected = False
    bench.host.poll(bench.now_s)
    bench.events += bench.host.link_lost(bench.now_s)
    assert bench.stage(lost) is Stage.UNKNOWN
    waiting = bench.host.submit("SET_EXPOSURE", {"exposure_ms": 123}, bench.now_s)
    bench.device._identity = Identity(serial="SIM-0002")
    bench.connected = True
    bench.host.link_up(bench.now_s)
    bench.until(lambda: bench.stage(waiting) is Stage.FAILED)
    last = bench.stages(waiting)[-1]
    assert last.reason == "withdrawn"
    assert "SIM-0002 answered" in last.detail
    with pytest.raises(NotFound):
        bench.host.retry(lost, bench.now_s)

"""Trace: times only with a clock."""

from __future__ import annotations

import pytest

from gss.pipeline.trace import Trace


def test_stages_add_up_by_the_callers_clock() -> None:
    """Seconds per stage come from the injected clock, a stage entered twice adds up, a failing one still counts."""
    ticks = iter([0.0, 2.0, 10.0, 11.0, 20.0, 25.0])
    trace = Trace(lambda: next(ticks))
    for _ in range(2):
        with trace.stage("detect"):
            pass
    with pytest.raises(ValueError), trace.stage("match"):
        raise ValueError
    assert trace.timing_s == {"detect": 3.0, "match": 5.0}


def test_without_a_clock_there_are_no_times() -> None:
    """No clock, no times; intermediates are kept all the same."""
    trace = Trace()
    with trace.stage("detect"):
        trace.keep("threshold", 13)
    assert trace.timing_s == {}
    assert trace.kept == {"threshold": 13}

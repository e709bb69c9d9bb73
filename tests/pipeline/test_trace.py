"""A trace records intermediate results, and times if a clock is given."""

from __future__ import annotations

import pytest

from gss.pipeline.trace import Trace


def test_stage_times_are_measured_with_the_given_clock() -> None:
    """The seconds of a stage are measured with the given clock. A stage that runs twice is summed, and a stage that
    fails is included.
    """
    ticks = iter([0.0, 2.0, 10.0, 11.0, 20.0, 25.0])
    trace = Trace(lambda: next(ticks))
    for _ in range(2):
        with trace.stage("detect"):
            pass
    with pytest.raises(ValueError), trace.stage("match"):
        raise ValueError
    assert trace.timing_s == {"detect": 3.0, "match": 5.0}


def test_a_trace_without_a_clock_has_no_times() -> None:
    """Without a clock there are no times, but intermediate results are recorded."""
    trace = Trace()
    with trace.stage("detect"):
        trace.keep("threshold", 13)
    assert trace.timing_s == {}
    assert trace.kept == {"threshold": 13}

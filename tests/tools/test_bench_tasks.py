"""Conversion of a browser trace into tasks of a page's main thread."""

from __future__ import annotations

from typing import Any

import pytest

from tools.bench_tasks import TASK, summary, tasks


def event(name: str, ts: float, dur: float, tdur: float, tid: int = 7, **data: Any) -> dict[str, Any]:
    """Return a complete event; times in microseconds, as in traces."""
    return {
        "ph": "X", "pid": 1, "tid": tid, "name": name, "ts": ts, "dur": dur, "tdur": tdur, "args": {"data": data}
    }  # fmt: skip


THREAD = {"ph": "M", "pid": 1, "tid": 7, "name": "thread_name", "args": {"name": "CrRendererMain"}}
TRACE = [
    event("Paint", 60_500, 9_000, 3_000),
    event(TASK, 0, 2_000, 1_000),
    THREAD,
    event(TASK, 50_000, 90_000, 60_000),
    event("FunctionCall", 51_000, 80_000, 50_000, functionName="draw"),
    event(TASK, 52_000, 1_000, 500),
    event(TASK, 0, 500_000, 400_000, tid=8),
]


def test_tasks_are_the_outermost_ones_of_the_main_thread():
    """Only outermost tasks of the main thread count. Processor time and wall time are separate."""
    main_tasks = tasks(TRACE)
    assert [(task.at_ms, task.processor_ms, task.wall_ms) for task in main_tasks] == [(0, 1, 2), (50, 60, 90)]


def test_the_time_of_a_function_excludes_called_functions():
    """The time of a function excludes the functions that it calls: of the 50 ms of drawing, 3 ms are painting and 0.5
    ms a task within it.
    """
    parts = tasks(TRACE)[1].parts
    assert parts == pytest.approx({"FunctionCall draw": 46.5, "Paint": 3.0, TASK: 0.5})


def test_a_task_above_fifty_milliseconds_is_long():
    """A task of 60 ms of processor time is long by processor time and by wall time."""
    result = summary(tasks(TRACE))
    assert (result["tasks"], result["long"], result["long_wall"], result["longest_ms"]) == (2, 1, 1, 60.0)

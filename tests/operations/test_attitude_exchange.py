"""Attitude messages of other systems are read with the limits of untrusted files."""

from __future__ import annotations

from datetime import timedelta

import numpy as np
import pytest

from gss.domain.errors import TooCostly
from gss.operations.frames.attitude_exchange import AttitudeExchange
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.operations.parsing.parse_worker import ParseLimits
from gss.orbit.attitude import AttitudeHistory
from gss.orbit.write_attitude import aem_of
from gss.store import frames as store
from gss.store.models import Frame, Solution


def test_a_message_is_read_in_a_child_process_with_limits(database, clock) -> None:
    """A message that exceeds the limits of the child process is rejected. 20 MB of very short lines would need more than a
    gigabyte of memory."""
    times_s = clock().timestamp() + np.arange(20.0)
    history = AttitudeHistory("A", "SC_BODY_1", times_s, np.tile([0, 0, 0, 1.0], (20, 1)), np.full((20, 3), np.nan))
    data = "".join(aem_of(history, clock())).encode()
    with ParseProcesses(ParseLimits(result_bytes=100)) as parsing:
        exchange = AttitudeExchange(database, parsing, "cubestar", lambda: "unit", clock)
        with pytest.raises(TooCostly, match="the message is too expensive to read"):
            exchange.compare(data, "ground")


def test_frames_of_other_cameras_and_without_a_time_are_not_exchanged(database, clock) -> None:
    """Frames from the unit and imported ones of its instrument are exported and compared, except those that have only the time
    of their import."""
    frames = [
        ("import", "cubestar", True),
        ("import", "cubestar", False),
        ("device", None, True),
        ("import", "aim", True),
        ("import", None, True),
    ]
    with database.unit_of_work() as session:
        for k, (source, profile, time_known) in enumerate(frames):
            taken = clock() + timedelta(seconds=k)
            frame = Frame(source=source, name=f"{k}", taken=taken, received=taken, columns=2, rows=2, bits=8)
            frame.dtype, frame.sha256, frame.time_known, frame.profile = "|u1", "0", time_known, profile
            store.add(session, frame)
            solution = Solution(frame_id=frame.id, origin="ground", chain="reference", version="1", created=taken)
            solution.outcome, solution.operational, solution.quaternion = "solved", True, [0.0, 0.0, 0.0, 1.0]
            store.add_solution(session, solution)
    with ParseProcesses() as parsing:
        exchange = AttitudeExchange(database, parsing, "cubestar", lambda: "unit", clock)
        span = clock(), clock() + timedelta(seconds=4)
        history = exchange.history("ground", *span)
        assert [t - clock().timestamp() for t in history.times_s] == [0, 2]
        comparison = exchange.compare("".join(exchange.message("aem", "ground", *span)).encode(), "ground")
    assert [row.frame_id for row in comparison.compared] == [1, 3]

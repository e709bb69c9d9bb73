"""The last solved attitude of a sensor with any order and names of the quaternion's elements."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest

from gss.device.session_events import Telemetry
from gss.instruments.telemetry_roles import AttitudeRole
from gss.operations.line.clock_correlation import Correlation
from gss.operations.line.line_events import LineBatch
from gss.operations.telemetry.last_attitude import LastAttitude

ROLE = AttitudeRole(packet="solution", quaternion=("w", "x", "y", "z"), order="scalar_first", outcome="valid")
AXIS = {"w": 0.5**0.5, "x": 0.5**0.5, "y": 0.0, "z": 0.0}
"""Rotation of the camera by 90° about its x axis: the boresight is along −y or +y of the inertial frame."""


class Seconds:
    value = 10.0

    def __call__(self) -> float:
        return self.value


def batch(at_s: float, **values: Any) -> LineBatch:
    packet = Telemetry("solution", 0.0, 0, values, values)
    return LineBatch((packet,), datetime(2026, 11, 23, tzinfo=UTC), at_s)


def test_the_last_solved_attitude_stays_with_its_age() -> None:
    """A later report without a solution does not replace the last attitude. Its outcome is stated."""
    clock = Seconds()
    last = LastAttitude(ROLE, clock, lambda: None)
    assert last.report() is None
    last.handle(batch(8.0, valid="solved", **AXIS))
    last.handle(batch(9.0, valid="none", w=1.0, x=0.0, y=0.0, z=0.0))
    report = last.report()
    assert report is not None
    assert report.age_s == pytest.approx(2.0)
    assert report.newest_outcome == "none"
    assert report.dec_deg == pytest.approx(0.0, abs=1e-9)
    assert report.ra_deg in (pytest.approx(90.0), pytest.approx(270.0))
    assert report.sigma_cross_arcsec is None


def test_the_mode_is_that_of_the_newest_report() -> None:
    """The mode is that of the newest report, also without a solution, and None before the first report."""
    role = ROLE.model_copy(update={"mode": "mode"})
    last = LastAttitude(role, Seconds(), lambda: None)
    assert last.mode() is None
    last.handle(batch(8.0, valid="none", mode="lost_in_space", **AXIS))
    assert last.mode() == "lost_in_space"


@pytest.mark.parametrize("bad", [{"w": 0.0, "x": 0.0}, {"w": float("nan")}])
def test_an_invalid_quaternion_gives_no_attitude(bad: dict[str, float]) -> None:
    """A quaternion of length zero or with NaN gives no attitude."""
    last = LastAttitude(ROLE, Seconds(), lambda: None)
    last.handle(batch(8.0, valid="solved", **{**AXIS, **bad}))
    assert last.report() is None


@pytest.mark.parametrize("frame_time_s", [1e300, -1e13])
def test_an_impossible_time_is_replaced_by_that_of_reception(frame_time_s: float) -> None:
    """If a faulty sensor sends a time outside the range of dates, its attitude has the time of reception."""
    role = ROLE.model_copy(update={"frame_time_s": "time"})
    last = LastAttitude(role, Seconds(), lambda: Correlation(0.0, 0.0, None, 0.0, 0.1, 2, 1.0))
    last.handle(batch(8.0, valid="solved", time=frame_time_s, **AXIS))
    sample = last.sample()
    assert sample is not None
    assert sample.utc == datetime(2026, 11, 23, tzinfo=UTC)

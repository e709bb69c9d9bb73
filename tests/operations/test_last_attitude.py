"""The last solved attitude of a sensor with any order and names of the quaternion's elements."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest

from gss.device.session_events import Telemetry
from gss.domain.errors import StoreDown
from gss.instruments.telemetry_roles import AttitudeRole
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.frames.ground_attitude import GroundAttitude
from gss.operations.line.clock_correlation import Correlation
from gss.operations.line.line_events import LineBatch
from gss.operations.telemetry.last_attitude import LastAttitude
from gss.store import frames as store
from gss.store.engine import Database
from gss.store.models import Frame, Solution

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


def test_a_ground_attitude_is_read_again_after_a_failure(database: Database, bus: EventBus, clock: Now) -> None:
    """If the store fails when a new attitude is read, the next request reads it."""
    ground = GroundAttitude(database, bus, lambda: None)
    with database.unit_of_work() as session:
        frame = Frame(source="device", name="", taken=clock(), received=clock(), columns=2, rows=2, bits=8)
        frame.dtype, frame.sha256 = "|u1", "0"
        store.add(session, frame)
        row = Solution(frame_id=frame.id, origin="ground", chain="reference", version="1", created=clock())
        row.outcome, row.operational, row.quaternion = "solved", True, [0.0, 0.0, 0.0, 1.0]
        store.add_solution(session, row)
    bus.publish("solution", row)
    with database.engine.begin() as connection:
        connection.exec_driver_sql("ALTER TABLE frames RENAME TO away")
    with pytest.raises(StoreDown):
        ground.sample()
    with database.engine.begin() as connection:
        connection.exec_driver_sql("ALTER TABLE away RENAME TO frames")
    sample = ground.sample()
    assert sample is not None
    assert sample.utc == clock()

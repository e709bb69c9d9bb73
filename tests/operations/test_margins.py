"""Alarms for the angles between boresight and Sun, Moon and Earth."""

from __future__ import annotations

from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np
import pytest

from gss.device.session_events import Telemetry
from gss.domain.angles import ra_dec_from_unit
from gss.domain.limits import State
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.instruments.telemetry_roles import AttitudeRole
from gss.operations.frames.margins import CURRENT_S, MarginWatch, margins_deg
from gss.operations.frames.place import Place
from gss.operations.frames.sky import bodies
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.last_attitude import LastAttitude, ReportedAttitude
from gss.operations.telemetry.telemetry import TelemetryService

AT = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)
SUN = next(b.icrs for b in bodies(AT) if b.name == "Sun")
LOW_ORBIT = Place(-6878.0 * SUN, "test")  # the Earth is between camera and Sun
ROLE = AttitudeRole(packet="attitude", quaternion=("x", "y", "z", "w"), outcome="outcome")


def facing(axis: np.ndarray) -> dict[str, float]:
    """Return a quaternion cam_from_icrs whose boresight is this unit vector."""
    half = np.cross(axis, [0.0, 0.0, 1.0])
    w = 1.0 + axis[2]
    x, y, z, w = np.array([*half, w]) / np.linalg.norm([*half, w])
    return {"x": x, "y": y, "z": z, "w": w}


def test_the_angle_to_the_earth_counts_from_its_limb() -> None:
    """For a boresight towards Sun and Earth's centre, the angle to the Sun is 0° and that to the limb is minus the angular
    radius of the Earth."""
    margins = margins_deg(SUN, AT, LOW_ORBIT)
    assert margins["Sun"] == (pytest.approx(0.0, abs=1e-5), pytest.approx(40.0))
    assert margins["Earth limb"][0] == pytest.approx(-np.degrees(np.arcsin(6378.137 / 6878.0)), abs=0.01)
    assert set(margins_deg(SUN, AT, None)) == {"Sun", "Moon"}


def test_an_alarm_follows_the_attitude_while_it_is_current(database, bus, clock, tmp_path) -> None:
    """The alarm is raised near the Sun, kept while there is no attitude, and cleared when the boresight points away."""
    clock.at = AT
    seconds = [0.0]
    dictionary = load_dictionary()
    queue = LineEventQueue(clock, lambda: 0.0)
    link = LinkService(dictionary, default_roles(dictionary), database, bus, tmp_path, clock, lambda: 0.0, queue)
    telemetry = TelemetryService(
        dictionary, database, bus, clock, lambda: None, lambda: True, default_roles(dictionary).quantities.status
    )
    alarms = AlarmService(dictionary, telemetry, link, database, bus, clock)
    attitude = LastAttitude(ROLE, lambda: seconds[0], lambda: None)
    places: list[Place | None] = [None]
    watch = MarginWatch(attitude, lambda at: places[0], alarms, clock)

    def after(step_s: float, axis: np.ndarray | None) -> list[tuple[str, State, str]]:
        clock.forward(step_s)
        seconds[0] += step_s
        if axis is not None:
            values = {"outcome": "solved", **facing(axis)}
            attitude.handle(LineBatch((Telemetry("attitude", 0.0, 0, values, values),), clock(), seconds[0]))
        watch.tick()
        return [(view.title, view.level, view.row.state) for view in alarms.opened()]

    assert after(1, -SUN) == []
    near = after(6, SUN)
    assert ("Angle to Sun", State.WARNING, "raised") in near
    assert after(2 * CURRENT_S, None) == near
    assert after(1, -SUN) == [(title, State.OK, "cleared") for title, _, _ in near]

    def limb() -> tuple[State, str, float | None]:
        return next((v.level, v.row.state, v.row.value) for v in alarms.opened() if v.title == "Angle to Earth limb")

    places[0] = Place(-6878.0 * SUN, "test")
    aside = SUN + 1.7 * np.cross(SUN, [0.0, 0.0, 1.0])
    after(6, aside / np.linalg.norm(aside))
    first = limb()[2]
    after(6, SUN)
    level, state, value = limb()
    assert (level, state, value < first) == (State.WARNING, "raised", True)  # the smallest angle
    places[0] = None  # the orbit is no longer known
    after(6, SUN)
    assert limb()[:2] == (State.OK, "cleared")


def test_sun_and_moon_are_checked_if_the_position_of_the_camera_cannot_be_read(clock) -> None:
    """If the position of the camera cannot be read, the alarms of Sun and Moon are updated and that of the limb is not."""
    clock.at = AT
    watched: list[tuple[str, State]] = []

    class Alarms:
        def watch(self, key: tuple[str, str], state: State, *_: object, **__: object) -> None:
            watched.append((key[1], state))

    def fail(at: datetime) -> Place | None:
        raise OSError("the store cannot be read")

    ra, dec = np.degrees(ra_dec_from_unit(SUN))
    report = ReportedAttitude(float(ra), float(dec), None, 0.0, "solved")
    watch = MarginWatch(SimpleNamespace(report=lambda: report), fail, Alarms(), clock)
    with pytest.raises(OSError, match="the store"):
        watch.tick()
    assert [name for name, _ in watched] == ["Sun", "Moon"]
    assert ("Sun", State.WARNING) in watched

"""Alarms that are raised while the sensor's boresight is too close to the Sun, the Moon or the Earth's limb."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import datetime, timedelta

import numpy as np

from gss.domain.angles import Array, unit_from_ra_dec
from gss.domain.limits import State
from gss.operations.clock import Now
from gss.operations.frames.place import EARTH_EXCLUSION_RAD, Place
from gss.operations.frames.sky import bodies
from gss.operations.telemetry.alarm_text import MARGIN
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.last_attitude import LastAttitude

CURRENT_S = 10.0
"""Maximum age of an attitude that is checked. An older attitude does not change the alarms, because the camera can have
moved since then."""
EVERY = timedelta(seconds=5)
LIMB = "Earth limb"
LEVELS = {"Sun": State.WARNING, "Moon": State.WATCH, LIMB: State.WARNING}


def margins_deg(boresight: Array, at: datetime, place: Place | None) -> dict[str, tuple[float, float]]:
    """Return for each body its angle from the boresight and the minimum angle, in degrees. ``boresight``: (3,) ICRS unit vector.
    The Earth's limb is omitted if the position of the camera is unknown."""
    margins = {body.name: _margin_deg(boresight, body.icrs, 0.0, body.exclusion_rad) for body in bodies(at)}
    return margins if place is None else margins | {LIMB: limb_deg(boresight, place)}


def limb_deg(boresight: Array, place: Place) -> tuple[float, float]:
    """Return the angle between the Earth's limb and the boresight, a (3,) ICRS unit vector, and the minimum angle, in degrees."""
    return _margin_deg(boresight, place.earth_icrs, place.earth_radius_rad, EARTH_EXCLUSION_RAD)


def _margin_deg(boresight: Array, direction: Array, radius: float, minimum: float) -> tuple[float, float]:
    angle = math.acos(float(np.clip(boresight @ direction, -1, 1)))
    return math.degrees(angle - radius), math.degrees(minimum)


class MarginWatch:
    """Compares the latest attitude in the sensor's telemetry with the directions of Sun, Moon and Earth."""

    def __init__(
        self, attitude: LastAttitude, place_at: Callable[[datetime], Place | None], alarms: AlarmService, now: Now
    ) -> None:
        self._attitude, self._place_at, self._alarms, self._now = attitude, place_at, alarms, now
        self._checked: datetime | None = None

    def tick(self) -> None:
        """Raise, update or clear the alarms. The check runs at most once per ``EVERY``, because it reads the position
        of the camera from the store."""
        now, report = self._now(), self._attitude.report()
        if self._checked is not None and abs(now - self._checked) < EVERY:
            return
        if report is None or report.age_s > CURRENT_S:
            return
        self._checked = now
        boresight = unit_from_ra_dec(math.radians(report.ra_deg), math.radians(report.dec_deg))
        self._watch(margins_deg(boresight, now, None))  # first, because the position of the camera may not be readable
        place = self._place_at(now)
        if place is None:
            self._alarms.watch((MARGIN, LIMB), State.OK, 0.0, "", "", judged=False)
        else:
            self._watch({LIMB: limb_deg(boresight, place)})

    def _watch(self, margins: dict[str, tuple[float, float]]) -> None:
        for name, (angle, minimum) in margins.items():
            level = LEVELS[name] if angle < minimum else State.OK
            limit = f"below {minimum:g}° ({level})"
            self._alarms.watch((MARGIN, name), level, round(angle, 1), f"{name} {angle:.1f}° from boresight", limit)

"""Position of the camera. It is computed from the first available source in this order: the orbit sent to the sensor,
the imported orbit of the spacecraft, the TLE of the active catalogue."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from sgp4.api import jday

from gss.catalogue_tools.corrections.ephemeris import teme_from_icrs
from gss.catalogue_tools.envelope.ellipse import EARTH_RADIUS_M
from gss.catalogue_tools.envelope.orbits import jyear_of, read_tle
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.frames import orbit_from_icrs
from gss.instruments.dictionary.checked_values import check_arguments
from gss.instruments.operations import Operation, StandardOperations
from gss.operations.line.clock_correlation import Correlation
from gss.operations.transfers.bank_history import BankHistoryService
from gss.orbit.trajectory import Trajectory, icrs_km
from gss.pipeline.chains.apriori import KnownOrbit
from gss.store import commands as store
from gss.store.engine import Database

EARTH_EXCLUSION_RAD = math.radians(25.0)
"""Minimum angle between the boresight and the Earth's limb."""


@dataclass(frozen=True)
class Place:
    """Position of the camera. ``km``: (3,) from the Earth's centre in ICRS axes. ``source``: source of the position."""

    km: Array
    source: str

    @property
    def earth_icrs(self) -> Array:
        """(3,) unit vector to the Earth's centre."""
        return np.asarray(-self.km / np.linalg.norm(self.km))

    @property
    def earth_radius_rad(self) -> float:
        """Angular radius of the Earth as seen from this position."""
        return math.asin(min(1.0, EARTH_RADIUS_M / 1000 / float(np.linalg.norm(self.km))))


class PlaceService:
    """Calculates the camera's position at past and future times. ``clock``: returns the correlation of the device's clock with
    UTC, None if unknown. ``orbit_at``: returns name and orbit of the spacecraft, None if no orbit covers the time."""

    def __init__(
        self,
        operations: StandardOperations,
        database: Database,
        banks: BankHistoryService,
        clock: Callable[[], Correlation | None],
        orbit_at: Callable[[datetime], tuple[str, Trajectory] | None],
    ) -> None:
        self._operations, self._database, self._banks, self._clock = operations, database, banks, clock
        self._orbit_at = orbit_at

    def at(self, moment: datetime) -> Place | None:
        """Return the position at a time with a time zone, None if no orbit is available."""
        return self._from_set_orbit(moment) or self._as_imported(moment) or self._as_built(moment)

    def _from_set_orbit(self, moment: datetime) -> Place | None:
        """Return the position from the latest completed SET_ORBIT. Its epoch is in device time, so the clocks must be
        correlated."""
        operations = self._operations
        if not operations.has(Operation.SET_ORBIT):
            return None
        command = operations.command(Operation.SET_ORBIT)
        with self._database.unit_of_work() as session:
            commands = store.page(session, store.Filter(names=(command,), results=("completed",)), 1)
        clock = self._clock()
        if not commands or clock is None:
            return None
        try:
            arguments = check_arguments(
                operations.dictionary.command(command), commands[0].arguments
            )  # adds the defaults
        except BadInput:  # the command was sent with another dictionary
            return None
        arguments = operations.given(Operation.SET_ORBIT, arguments)
        return Place(circular_km(arguments, clock.device_of(moment.timestamp())), "orbit from SET_ORBIT")

    def _as_imported(self, moment: datetime) -> Place | None:
        imported_orbit = self._orbit_at(moment)
        if imported_orbit is None:
            return None
        name, orbit = imported_orbit
        return Place(icrs_km(orbit, moment), f"orbit of {name}")

    def _as_built(self, moment: datetime) -> Place | None:
        stay = self._banks.active()
        catalogue = None if stay is None else stay.catalogue
        if catalogue is None or catalogue.request.get("orbit") != "tle":
            return None
        try:
            return Place(tle_km(str(catalogue.request.get("tle", "")), moment), f"TLE of catalogue {catalogue.name}")
        except BadInput:  # the element set is not valid at this time
            return None


def circular_km(arguments: Mapping[str, Any], device_s: float) -> Array:
    """Return the (3,) position at a device time, km, ICRS axes, from the arguments of SET_ORBIT."""
    raan, inclination, latitude = (
        math.radians(float(arguments[f"{a}_deg"])) for a in ("raan", "inclination", "latitude")
    )
    orbit = KnownOrbit(
        raan, inclination, latitude, 1000.0 * float(arguments["altitude_km"]), float(arguments["epoch_s"])
    )
    now = orbit.elements_at(device_s)
    nadir = orbit_from_icrs(now.raan_rad, now.inclination_rad, now.latitude_rad)[2]
    return np.asarray(-nadir * (EARTH_RADIUS_M + orbit.altitude_m) / 1000)


def tle_km(text: str, moment: datetime) -> Array:
    """Return the (3,) position of a TLE at a time by SGP4, km, ICRS axes. Raises BadInput if the element set has no orbit at that
    time."""
    utc = moment.astimezone(UTC)
    jd, part = jday(utc.year, utc.month, utc.day, utc.hour, utc.minute, utc.second + utc.microsecond * 1e-6)
    error, place_km, _ = read_tle(text).sgp4(jd, part)
    if error:
        raise BadInput("the element set has no orbit at that time", expected="a time near its epoch", got=f"{utc}")
    return np.asarray(teme_from_icrs(jyear_of(moment)).T @ np.asarray(place_km))

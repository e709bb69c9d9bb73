"""Positions of a spacecraft over time, from a two-line element set (SGP4) or from an ephemeris of state vectors.

Times are Unix seconds (UTC). All positions are in TEME, the axes of SGP4. A rotation about the pole by Greenwich mean sidereal time
of 1982 transforms them to Earth-fixed axes (Vallado 2013 §3.7). UT1 is assumed to be UTC (error below 0.9 s) and polar motion to be
zero (error below 0.6″). The resulting error of a rise or set is at most 0.1 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Protocol

import erfa  # type: ignore[import-untyped]  # the package has no types
import numpy as np
from sgp4.api import Satrec
from sgp4.conveniences import sat_epoch_datetime

from gss.catalogue_tools.corrections.ephemeris import bodies_at, teme_from_icrs
from gss.catalogue_tools.envelope.orbits import SGP4_WORDS, TLE_VALID_BEFORE_DAYS, TLE_VALID_DAYS, jyear_of, read_tle
from gss.domain.angles import Array
from gss.domain.errors import BadInput

UNIX_EPOCH_JD = 2440587.5
DAY_S = 86_400.0
EPHEMERIS_POINTS = 8
"""Number of points of a Lagrange interpolation: the usual number for CCSDS OEM files with steps of one minute."""


class Trajectory(Protocol):
    """Positions of a spacecraft over time. ``epoch``: epoch of the elements, or time of the first state of an ephemeris. ``start``,
    ``end``: time span in which positions are defined."""

    @property
    def epoch(self) -> datetime: ...
    @property
    def start(self) -> datetime: ...
    @property
    def end(self) -> datetime: ...

    def teme_km(self, unix_s: Array) -> Array:
        """Return (n, 3) positions from the Earth's centre at (n,) Unix seconds. Raises BadInput outside the time span."""


@dataclass(frozen=True)
class TleTrajectory:
    """Orbit of a two-line element set, calculated by SGP4."""

    satellite: Satrec
    epoch: datetime
    start: datetime
    end: datetime

    @classmethod
    def of(cls, text: str) -> TleTrajectory:
        """Read a TLE with or without a name line. Raises BadInput that names the invalid line."""
        satellite = read_tle(text)
        epoch = sat_epoch_datetime(satellite).astimezone(UTC)
        return cls(satellite, epoch, *(_moment(unix_s(epoch) + days * DAY_S) for days in VALID_DAYS))

    def teme_km(self, unix_s: Array) -> Array:
        """Return (n, 3) positions at (n,) Unix seconds by SGP4. Raises BadInput outside the time span."""
        seconds = np.asarray(unix_s, float)
        _check_span(seconds, self.start, self.end)
        days = np.floor(seconds / DAY_S)
        errors, places_km, _ = self.satellite.sgp4_array(UNIX_EPOCH_JD + days, seconds / DAY_S - days)
        if errors.any():
            reason = SGP4_WORDS.get(int(errors.max()), f"SGP4 error {errors.max()}")
            raise BadInput(
                "the element set has no orbit at that time",
                expected="a satellite in orbit",
                got=reason,
                hint="Import newer elements.",
            )
        return np.asarray(places_km)


VALID_DAYS = (-TLE_VALID_BEFORE_DAYS, TLE_VALID_DAYS)


@dataclass(frozen=True)
class EphemerisTrajectory:
    """Orbit from an ephemeris of states. ``times_s``: (n,) Unix seconds, increasing. ``places_km``: (n, 3) positions in TEME."""

    times_s: Array
    places_km: Array

    @property
    def epoch(self) -> datetime:
        """Time of the first state."""
        return self.start

    @property
    def start(self) -> datetime:
        """Time of the first state."""
        return _moment(float(self.times_s[0]))

    @property
    def end(self) -> datetime:
        """Time of the last state."""
        return _moment(float(self.times_s[-1]))

    def teme_km(self, unix_s: Array) -> Array:
        """Return (n, 3) positions at (n,) Unix seconds by Lagrange interpolation through the nearest states. Raises BadInput
        outside the time span."""
        seconds = np.asarray(unix_s, float)
        _check_span(seconds, self.start, self.end)
        points = min(EPHEMERIS_POINTS, len(self.times_s))
        first = np.searchsorted(self.times_s, seconds) - points // 2
        index = np.clip(first, 0, len(self.times_s) - points)[:, None] + np.arange(points)
        knots_s, places_km = self.times_s[index], self.places_km[index]
        weights = np.ones_like(knots_s)
        for j in range(points):
            for k in range(points):
                if j != k:
                    weights[:, j] *= (seconds - knots_s[:, k]) / (knots_s[:, j] - knots_s[:, k])
        return np.asarray(np.einsum("nk,nki->ni", weights, places_km))


def earth_fixed_km(orbit: Trajectory, unix_s: Array) -> Array:
    """Return (n, 3) positions in Earth-fixed axes (ITRF), km, at (n,) Unix seconds."""
    return fixed_from_teme(orbit.teme_km(unix_s), unix_s)


def fixed_from_teme(teme: Array, unix_s: Array) -> Array:
    """Rotate (n, 3) vectors from TEME into Earth-fixed axes at (n,) Unix seconds."""
    seconds = np.asarray(unix_s, float)
    days = np.floor(seconds / DAY_S)
    angle = erfa.gmst82(UNIX_EPOCH_JD + days, seconds / DAY_S - days)
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = teme[:, 0], teme[:, 1], teme[:, 2]
    return np.stack([c * x + s * y, c * y - s * x, z], axis=1)


def teme_from_fixed(fixed: Array, unix_s: Array) -> Array:
    """Rotate (n, 3) vectors from Earth-fixed axes into TEME at (n,) Unix seconds."""
    mirror = np.array([1.0, -1.0, 1.0])  # a rotation by −angle is the rotation by +angle in mirrored axes
    return np.asarray(fixed_from_teme(fixed * mirror, unix_s) * mirror)


def sun_teme_km(moment: datetime) -> Array:
    """Return the (3,) position of the Sun from the Earth's centre in TEME at a time with a time zone."""
    jyear = jyear_of(moment)
    sun = bodies_at(jyear).sun
    return np.asarray(teme_from_icrs(jyear) @ sun.icrs * sun.distance_km)


def icrs_km(orbit: Trajectory, moment: datetime) -> Array:
    """Return the (3,) position from the Earth's centre in ICRS axes at a time with a time zone. Raises BadInput outside the time
    span."""
    return np.asarray(teme_from_icrs(jyear_of(moment)).T @ orbit.teme_km(np.array([unix_s(moment)]))[0])


def unix_s(moment: datetime) -> float:
    """Return the Unix seconds of a time with a time zone."""
    return moment.timestamp()


def _moment(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)


def _check_span(seconds: Array, start: datetime, end: datetime) -> None:
    if len(seconds) and (seconds.min() < unix_s(start) or seconds.max() > unix_s(end)):
        raise BadInput(
            "the time is outside the validity of the orbit",
            expected=f"{start:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC",
            got=f"{_moment(float(seconds.min())):%Y-%m-%d %H:%M} to {_moment(float(seconds.max())):%Y-%m-%d %H:%M} UTC",
            hint="Import newer elements.",
        )

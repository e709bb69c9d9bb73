"""Positions of a spacecraft over time, from a two-line element set (SGP4) or from an ephemeris of state vectors.

Times are Unix seconds (UTC). All positions are in TEME, the axes of SGP4. A rotation about the pole by Greenwich mean sidereal time
of 1982 transforms them to Earth-fixed axes (Vallado 2013 §3.7). UT1 is assumed to be UTC (error below 0.9 s) and polar motion to be
zero (error below 0.6″). The resulting error of a rise or set is at most 0.1 s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Protocol

import erfa  # type: ignore[import-untyped]  # the package has no types
import numpy as np
from sgp4.api import Satrec
from sgp4.conveniences import sat_epoch_datetime

from gss.catalogue_tools.corrections.ephemeris import bodies_at, teme_from_icrs
from gss.catalogue_tools.envelope.ellipse import EARTH_MU_M3_S2
from gss.catalogue_tools.envelope.orbits import SGP4_WORDS, TLE_VALID_BEFORE_DAYS, TLE_VALID_DAYS, jyear_of, read_tle
from gss.domain.angles import Array, separation_rad
from gss.domain.errors import BadInput

UNIX_EPOCH_JD = 2440587.5
DAY_S = 86_400.0
EPHEMERIS_POINTS = 8
"""Number of points of a Lagrange interpolation: the usual number for CCSDS OEM files with steps of one minute."""
HERMITE_POINTS = 4
"""Number of points of a Hermite interpolation: degree 7. More points are less accurate with steps of 20 min in low orbits."""


Spans = tuple[tuple[float, float], ...]
"""Time spans as first and last Unix seconds, in order of time and separated by gaps."""


class Trajectory(Protocol):
    """Positions of a spacecraft over time. ``epoch``: epoch of the elements, or time of the first state of an ephemeris. ``spans``:
    time spans in which positions are defined. ``start``, ``end``: limits of the first and last span."""

    @property
    def epoch(self) -> datetime: ...
    @property
    def start(self) -> datetime: ...
    @property
    def end(self) -> datetime: ...
    @property
    def spans(self) -> Spans: ...

    def teme_km(self, unix_s: Array) -> Array:
        """Return (n, 3) positions from the Earth's centre at (n,) Unix seconds. Raises BadInput outside the time spans."""


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

    @property
    def spans(self) -> Spans:
        """The validity of the elements."""
        return ((unix_s(self.start), unix_s(self.end)),)

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
class EphemerisSegment:
    """States of an ephemeris between which positions are interpolated. ``times_s``: (n,) Unix seconds, increasing. ``places_km``:
    (n, 3) positions in TEME. ``velocities_km_s``: (n, 3), for Hermite interpolation; None for Lagrange interpolation."""

    times_s: Array
    places_km: Array
    velocities_km_s: Array | None = None

    @property
    def _points(self) -> int:
        return min(EPHEMERIS_POINTS if self.velocities_km_s is None else HERMITE_POINTS, len(self.times_s))

    def teme_km(self, seconds: Array) -> Array:
        """Return (n, 3) positions at (n,) Unix seconds by interpolation through the nearest states."""
        points = self._points
        first = np.searchsorted(self.times_s, seconds) - points // 2
        index = np.clip(first, 0, len(self.times_s) - points)[:, None] + np.arange(points)
        knots_s, places_km = self.times_s[index], self.places_km[index]
        weights, slopes = np.ones_like(knots_s), np.zeros_like(knots_s)
        for j in range(points):
            for k in range(points):
                if j != k:
                    weights[:, j] *= (seconds - knots_s[:, k]) / (knots_s[:, j] - knots_s[:, k])
                    slopes[:, j] += 1 / (knots_s[:, j] - knots_s[:, k])
        if self.velocities_km_s is None:
            return np.asarray(np.einsum("nk,nki->ni", weights, places_km))
        since_s = seconds[:, None] - knots_s
        moved_km = since_s[..., None] * (self.velocities_km_s[index] - 2 * slopes[..., None] * places_km)
        return np.asarray(np.einsum("nk,nki->ni", weights**2, places_km + moved_km))

    @property
    def error_km(self) -> float:
        """Largest error of an interpolated position: the remainder of the interpolation of a circular motion in the first or last
        interval, with the largest angle between two states and the largest distance from the Earth's centre. The angle is at
        least that of a circular orbit at this distance: states a revolution apart have almost the same direction."""
        n, values = self._points, 1 if self.velocities_km_s is None else 2
        if n == 1:
            return 0.0
        range_km = np.linalg.norm(self.places_km, axis=1)
        circular_rad = np.diff(self.times_s).max() * math.sqrt(EARTH_MU_M3_S2 / (1e3 * max(range_km.max(), 1.0)) ** 3)
        step_rad = max(separation_rad(self.places_km[1:], self.places_km[:-1]).max(), circular_rad)
        distances = math.prod(abs(k - 0.5) for k in range(n))
        return float(range_km.max() * (distances * step_rad**n) ** values / math.factorial(n * values))


@dataclass(frozen=True)
class EphemerisTrajectory:
    """Orbit from an ephemeris of states. ``segments``: in order of time. A segment can start at the last time of the previous one.
    Positions are not defined in the gaps between segments."""

    segments: tuple[EphemerisSegment, ...]

    @property
    def epoch(self) -> datetime:
        """Time of the first state."""
        return self.start

    @property
    def start(self) -> datetime:
        """Time of the first state."""
        return _moment(self.spans[0][0])

    @property
    def end(self) -> datetime:
        """Time of the last state."""
        return _moment(self.spans[-1][1])

    @property
    def spans(self) -> Spans:
        """First and last times of the segments; segments without a gap are one span."""
        spans: list[tuple[float, float]] = []
        for segment in self.segments:
            first_s, last_s = float(segment.times_s[0]), float(segment.times_s[-1])
            if spans and spans[-1][1] == first_s:
                first_s = spans.pop()[0]
            spans.append((first_s, last_s))
        return tuple(spans)

    def teme_km(self, unix_s: Array) -> Array:
        """Return (n, 3) positions at (n,) Unix seconds by interpolation inside one segment. Raises BadInput outside them."""
        seconds = np.asarray(unix_s, float)
        _check_span(seconds, self.start, self.end)
        places_km = np.full((len(seconds), 3), np.nan)
        for segment in self.segments:
            inside = np.flatnonzero((seconds >= segment.times_s[0]) & (seconds <= segment.times_s[-1]))
            places_km[inside] = segment.teme_km(seconds[inside])
        missing_s = seconds[np.isnan(places_km[:, 0])]
        if len(missing_s):
            raise BadInput(
                "the time is in a gap of the ephemeris",
                expected="a time inside a segment",
                got=f"{_moment(float(missing_s[0])):%Y-%m-%d %H:%M} UTC",
                hint="Import an ephemeris without this gap.",
            )
        return places_km


def covers(orbit: Trajectory, moment: datetime) -> bool:
    """True if the position is defined at a time with a time zone."""
    return any(first_s <= unix_s(moment) <= last_s for first_s, last_s in orbit.spans)


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

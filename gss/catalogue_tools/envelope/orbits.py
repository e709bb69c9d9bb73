"""Ranges of orbital planes, computed from limits of the elements or from a TLE over a number of days."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from sgp4.api import Satrec, jday
from sgp4.conveniences import sat_epoch_datetime

from gss.catalogue_tools.corrections.corrections import date_from_icrs
from gss.catalogue_tools.envelope.ellipse import EARTH_RADIUS_M, MIN_ORBIT_M, Ellipse
from gss.domain.angles import Array, wrap_pi_rad
from gss.domain.errors import BadInput

Range = tuple[float, float]
# Smallest eccentricity of a TLE that is used. Below it the altitude of a low orbit varies by less than 15 km from the mean.
MIN_ECCENTRICITY = 0.002
# Number of days for which the node of a low orbit, predicted from mean elements, is accurate to about 0.1°.
TLE_VALID_DAYS = 60.0
TLE_VALID_BEFORE_DAYS = 7.0
SGP4_WORDS = {
    1: "mean eccentricity out of range",
    2: "mean motion below zero",
    3: "perturbed eccentricity out of range",
    4: "semi-latus rectum below zero",
    6: "the orbit has decayed",
}


@dataclass(frozen=True)
class OrbitRanges:
    """Orbital planes in ICRS axes: every inclination with every node, at every argument of latitude.

    ``raan_start_rad``, ``raan_end_rad``: the node at the two ends of validity. ``ellipse``: shape of an eccentric orbit, None
    for circular orbits. The shape does not change the planes, only the time at each argument of latitude and the distance
    from the Earth.
    """

    inclination_rad: Range
    raan_rad: Range
    raan_start_rad: float
    raan_end_rad: float
    ellipse: Ellipse | None = None

    def raan_at(self, part: Array) -> Array:
        """Return the node after (n,) fractions of the validity."""
        return np.asarray(self.raan_start_rad + (self.raan_end_rad - self.raan_start_rad) * np.asarray(part))

    def raan_drifted(self, part: Array, raan_rad: Array) -> Array:
        """Return the nodes after (n,) fractions of the validity. ``raan_rad``: (n,) nodes spread over the limits, which are
        narrowed to the limits of the first day."""
        low, high = self.raan_rad
        drift = abs(self.raan_end_rad - self.raan_start_rad)
        first_day = max(0.0, high - low - drift) / max(high - low, 1e-12)
        return np.asarray(self.raan_at(part) + (raan_rad - (low + high) / 2) * first_day)

    def latitude_at(self, part: Array, turn: Array) -> tuple[Array, Array | None]:
        """Return the (n,) arguments of latitude after (n,) fractions ``turn`` of an orbit in time, and the (n,) distances from
        the Earth's centre in m, None for circular orbits."""
        return (2 * np.pi * turn, None) if self.ellipse is None else self.ellipse.latitude_at(part, turn)


def from_elements(inclination_rad: Range, raan_rad: Range) -> OrbitRanges:
    """Return the planes for given limits (Jacobs 1995 Table 5-2); a node range across 0° is written 350° to 370°."""
    low, high = ordered("inclination", inclination_rad)
    if low < 0 or high > np.pi:
        raise BadInput(
            "inclination is out of range", expected="0° to 180°", got=f"{np.degrees(low):g}° to {np.degrees(high):g}°"
        )
    start, end = ordered("right ascension of the node", raan_rad, hint="write a range across 0° as 350:370")
    return OrbitRanges((low, high), (start, end), start, end)


def from_tle(text: str, start: datetime, days: float) -> OrbitRanges:
    """Return the planes of a satellite over ``days`` from ``start`` (UTC, with a time zone).

    Uses the secular J2 drift of SGP4's mean node and perigee, rotated from the equator of date to ICRS. Raises BadInput if the TLE
    or the dates are not valid.
    """
    satellite = read_tle(text)
    end = start + timedelta(days=days)
    _check_span(satellite, start, end)
    normals = [_mean_normal(satellite, start + (end - start) * part) for part in (0.0, 0.5, 1.0)]
    inclination = [float(np.arctan2(np.hypot(n[0], n[1]), n[2])) for n in normals]
    raan = [float(np.arctan2(n[0], -n[1]) % (2 * np.pi)) for n in normals]
    for k in (1, 2):  # unwrap the drift across 0°
        raan[k] = raan[k - 1] + float(wrap_pi_rad(raan[k] - raan[k - 1]))
    ellipse = _ellipse_of(satellite, start, end)
    return OrbitRanges((min(inclination), max(inclination)), (min(raan), max(raan)), raan[0], raan[2], ellipse)


def read_tle(text: str) -> Satrec:
    """Return the satellite of a two-line element set with or without a name line. Raises BadInput if a line is not
    valid."""
    lines = [line.rstrip() for line in text.strip().splitlines() if line.strip()]
    lines = lines[1:] if len(lines) == 3 else lines
    if len(lines) != 2 or not (lines[0].startswith("1 ") and lines[1].startswith("2 ")):
        raise BadInput(
            "not a two-line element set",
            expected="line 1 and line 2, with an optional name line before them",
            got=f"{len(lines)} lines",
        )
    for line in lines:
        _check_line(line)
    if lines[0][2:7] != lines[1][2:7]:
        raise BadInput("the two TLE lines are of different satellites", expected=lines[0][2:7], got=lines[1][2:7])
    try:
        satellite = Satrec.twoline2rv(*lines)
    except (ValueError, IndexError) as error:
        raise BadInput("the TLE cannot be read", expected="numbers in their columns", got=str(error)) from None
    _check_epoch(satellite)
    if satellite.error:
        raise BadInput(
            "the TLE does not describe an orbit",
            expected="the elements of a satellite in orbit",
            got=SGP4_WORDS.get(satellite.error, f"SGP4 error {satellite.error}"),
            hint="check the pasted lines",
        )
    perigee_m = satellite.altp * EARTH_RADIUS_M
    if perigee_m < MIN_ORBIT_M:
        raise BadInput(
            "the orbit has decayed",
            expected=f"a perigee above {MIN_ORBIT_M / 1e3:g} km",
            got=f"{perigee_m / 1e3:.0f} km",
            hint="use a newer TLE if the satellite is still in orbit",
        )
    return satellite


def altitude_of_tle(text: str) -> float:
    """Return the altitude of the mean orbit in metres: its semi-major axis minus the Earth's equatorial radius."""
    satellite = read_tle(text)
    return float(satellite.a * EARTH_RADIUS_M - EARTH_RADIUS_M)


def ordered(quantity: str, limits: Range, hint: str = "") -> Range:
    """Return the limits. Raises BadInput unless they are finite and in ascending order."""
    low, high = float(limits[0]), float(limits[1])
    if not (np.isfinite(low) and np.isfinite(high)):
        raise BadInput(f"{quantity} is not a number", expected="two finite limits", got=f"{low} to {high}")
    if low > high:
        got = f"{np.degrees(low):g}° to {np.degrees(high):g}°"
        raise BadInput(f"{quantity}: the minimum is above the maximum", expected="minimum:maximum", got=got, hint=hint)
    return low, high


def _check_epoch(satellite: Satrec) -> None:
    try:
        sat_epoch_datetime(satellite)
    except (ValueError, OverflowError) as error:
        raise BadInput(
            "the epoch of the TLE is not a valid date", expected="a year and its day", got=str(error)
        ) from None


def _check_line(line: str) -> None:
    if not line.isascii():
        raise BadInput("TLE line is not plain text", expected="ASCII", got=line)
    if len(line) != 69 or not line[68].isdigit():
        raise BadInput("TLE line has the wrong length", expected="69 columns", got=f"{len(line)} columns: {line!r}")
    total = sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10
    if total != int(line[68]):
        raise BadInput(
            f"TLE line {line[0]} has a wrong checksum", expected=str(total), got=line[68], hint="check the pasted lines"
        )


def _check_span(satellite: Satrec, start: datetime, end: datetime) -> None:
    if start.tzinfo is None:
        raise BadInput("the start has no time zone", expected="a time with its offset from UTC", got=str(start))
    epoch = sat_epoch_datetime(satellite)
    before, after = (epoch - start) / timedelta(days=1), (end - epoch) / timedelta(days=1)
    if not end > start:
        raise BadInput("the time span is empty", expected="a positive number of days", got=f"{start} to {end}")
    if before > TLE_VALID_BEFORE_DAYS or after > TLE_VALID_DAYS:
        raise BadInput(
            "the dates are outside the TLE's validity",
            expected=f"{TLE_VALID_BEFORE_DAYS:g} days before to {TLE_VALID_DAYS:g} days after {epoch:%Y-%m-%d}",
            got=f"{start:%Y-%m-%d} to {end:%Y-%m-%d}",
            hint="use a newer TLE, or give the limits of the node",
        )
    for moment in (start, end):
        error, _, _ = satellite.sgp4(*_julian(moment))
        if error:
            reason = SGP4_WORDS.get(error, f"SGP4 error {error}")
            raise BadInput(
                f"no orbit at {moment:%Y-%m-%d}",
                expected="a satellite in orbit",
                got=reason,
                hint="use a newer TLE or fewer days",
            )


def _mean_normal(satellite: Satrec, moment: datetime) -> Array:
    """Return the (3,) ICRS unit vector along the orbital momentum, from the mean elements with their secular rate."""
    raan, i = satellite.nodeo + satellite.nodedot * _minutes(satellite, moment), satellite.inclo
    normal = np.array([np.sin(raan) * np.sin(i), -np.cos(raan) * np.sin(i), np.cos(i)])
    return np.asarray(date_from_icrs(jyear_of(moment)).T @ normal)


def _ellipse_of(satellite: Satrec, start: datetime, end: datetime) -> Ellipse | None:
    """Return the mean ellipse with the secular drift of its perigee; None if the orbit is nearly circular. The argument of perigee
    is counted from the node of date, which is less than half a degree from that in ICRS axes."""
    if satellite.ecco < MIN_ECCENTRICITY:
        return None
    first, last = (float(satellite.argpo + satellite.argpdot * _minutes(satellite, moment)) for moment in (start, end))
    return Ellipse(float(satellite.ecco), float(satellite.a * EARTH_RADIUS_M - EARTH_RADIUS_M), first, last)


def _minutes(satellite: Satrec, moment: datetime) -> float:
    """Minutes since the epoch of the elements."""
    jd, part = _julian(moment)
    return float((jd - satellite.jdsatepoch + part - satellite.jdsatepochF) * 1440.0)


def _julian(moment: datetime) -> tuple[float, float]:
    utc = moment - (moment.utcoffset() or timedelta())
    jd, part = jday(utc.year, utc.month, utc.day, utc.hour, utc.minute, utc.second + utc.microsecond * 1e-6)
    return float(jd), float(part)


def jyear_of(moment: datetime) -> float:
    """Julian year of a time with a time zone."""
    jd, part = _julian(moment)
    return 2000.0 + (jd - 2451545.0 + part) / 365.25

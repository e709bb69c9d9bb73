"""Tracks of Sun, Moon and planets over the validity of a catalogue. Star lists do not contain these bright objects
(Moniteq 1983 §2.3).

The builder's warnings and the sensor's exclusion list use the tracks. Directions are apparent directions for an
observer at the Earth's centre, with annual aberration. From a low orbit the Moon appears up to a degree away from this
direction. ``Track.margin_rad`` is the upper limit of this angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.corrections.corrections import DAYS_PER_YEAR, aberrate
from gss.catalogue_tools.corrections.ephemeris import AU_KM, DAY_S, PLANETS, TT_MINUS_UTC_S, Bodies, bodies_at
from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.domain.angles import Array, ra_dec_from_unit
from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject

PLANET_RADIUS_KM = (2440.5, 6051.8, 3396.2, 71492.0, 60268.0, 25559.0, 24764.0)
LOW_ORBIT_KM = 7000.0
MAX_SAMPLES = 20_000
MAX_DAYS = 3660.0
# Moniteq 1983 §2.3: a "star" brighter than this and within this angle of the ecliptic may be a planet.


@dataclass(frozen=True)
class Track:
    """Track of one body over the sampled dates.

    ``icrs``: (k, 3) apparent directions; ``v_mag``, ``radius_rad``: (k,). ``margin_rad``: largest parallax for an
    observer in a low orbit.
    """

    name: str
    icrs: Array
    v_mag: Array
    radius_rad: Array
    margin_rad: float

    @property
    def brightest_mag(self) -> float:
        """Smallest magnitude along the track."""
        return float(self.v_mag.min())

    @property
    def faintest_mag(self) -> float:
        """Largest magnitude along the track."""
        return float(self.v_mag.max())


@dataclass(frozen=True)
class Exclusions:
    """Tracks of the bodies to exclude.

    ``jyear``: (k,) samples from start to end, UTC. ``tracks``: Sun, Moon, and the planets that are brighter than
    ``limit_mag`` at any sample.
    """

    jyear: Array
    tracks: tuple[Track, ...]
    limit_mag: float

    def track(self, name: str) -> Track | None:
        """Return the track of a body; None if the body is always fainter than ``limit_mag``."""
        return next((track for track in self.tracks if track.name == name), None)

    def as_dict(self) -> JsonObject:
        """Plain values, angles in radians."""
        return {
            "jyear": self.jyear.tolist(),
            "limit_mag": self.limit_mag,
            "tracks": [_plain(track) for track in self.tracks],
        }


def exclusions(
    start: datetime, days: float, *, limit_mag: float = 6.0, step_days: float = 1.0, observer_km: Array | None = None
) -> Exclusions:
    """Compute the tracks from ``start`` (with a time zone) over ``days``, both ends included, in steps of at most ``step_days``.

    ``observer_km``: (3,) from the Earth's centre, ICRS axes; None: the centre. The Moon moves 0.5° per hour, so steps
    of 0.1 days or less are needed to follow it. Raises BadInput for invalid dates, steps or limits.
    """
    if start.tzinfo is None:
        raise BadInput("the start has no time zone", expected="a time with its offset from UTC", got=str(start))
    if not 0 < days <= MAX_DAYS:
        raise BadInput(
            "the date range is out of range", expected=f"more than 0, at most {MAX_DAYS:g} days", got=f"{days}"
        )
    if not (step_days > 0 and days / step_days <= MAX_SAMPLES):
        raise BadInput(
            "the step is out of range for these dates",
            expected=f"above 0, at most {MAX_SAMPLES} samples",
            got=f"{step_days} days in {days}",
        )
    if not np.isfinite(limit_mag):
        raise BadInput("the magnitude limit is not a number", expected="a magnitude", got=str(limit_mag))
    count = int(np.ceil(days / step_days)) + 1
    jyear = jyear_of(start) + np.linspace(0.0, days, count) / DAYS_PER_YEAR
    terrestrial = jyear + TT_MINUS_UTC_S / DAY_S / DAYS_PER_YEAR
    bodies = [bodies_at(float(year), observer_km) for year in terrestrial]
    parallax_km = 0.0 if observer_km is not None else LOW_ORBIT_KM
    tracks = [_disc_track(bodies, "Sun", parallax_km), _disc_track(bodies, "Moon", parallax_km)]
    tracks += [_planet_track(bodies, i, parallax_km) for i in range(len(PLANETS))]
    bright_tracks = tuple(t for t in tracks if t.name in ("Sun", "Moon") or t.brightest_mag <= limit_mag)
    return Exclusions(jyear, bright_tracks, float(limit_mag))


def within(tracks: Exclusions, contains: Any, names: tuple[str, ...] = ()) -> dict[str, NDArray[np.bool_]]:
    """Return, for each track, the (k,) mask of the samples inside a region. ``contains`` is a function of (n, 3)
    directions, such as ``Envelope.contains``."""
    return {t.name: np.asarray(contains(t.icrs), bool) for t in tracks.tracks if not names or t.name in names}


def _disc_track(series: list[Bodies], name: str, parallax_km: float) -> Track:
    discs = [bodies.sun if name == "Sun" else bodies.moon for bodies in series]
    nearest = min(disc.distance_km for disc in discs)
    # The Moon moves around the Sun with the Earth, so it has no annual aberration.
    places = np.stack([d.icrs if name == "Moon" else _apparent(d.icrs, b) for d, b in zip(discs, series, strict=True)])
    return Track(
        name,
        places,
        np.array([disc.v_mag for disc in discs]),
        np.array([disc.radius_rad for disc in discs]),
        float(np.arcsin(parallax_km / nearest)),
    )


def _planet_track(series: list[Bodies], index: int, parallax_km: float) -> Track:
    places = np.stack([_apparent(bodies.planets_icrs[index], bodies) for bodies in series])
    distance_km = np.array([bodies.planets_au[index] for bodies in series]) * AU_KM
    return Track(
        PLANETS[index],
        places,
        np.array([bodies.planets_v_mag[index] for bodies in series]),
        np.arcsin(PLANET_RADIUS_KM[index] / distance_km),
        float(np.arcsin(parallax_km / distance_km.min())),
    )


def _apparent(icrs: Array, bodies: Bodies) -> Array:
    return np.asarray(aberrate(icrs, bodies.earth_velocity_c))


def _plain(track: Track) -> JsonObject:
    ra, dec = ra_dec_from_unit(track.icrs)
    return {
        "name": track.name,
        "ra_rad": ra.tolist(),
        "dec_rad": dec.tolist(),
        "v_mag": track.v_mag.tolist(),
        "radius_rad": track.radius_rad.tolist(),
        "margin_rad": track.margin_rad,
        "brightest_mag": track.brightest_mag,
        "faintest_mag": track.faintest_mag,
    }

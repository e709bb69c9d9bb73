"""Catalogue of orbiting objects: their directions as seen by an observer, and the identification of measured tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property

import numpy as np
from sgp4.api import Satrec, SatrecArray
from sgp4.conveniences import sat_epoch_datetime

from gss.catalogue_tools.corrections.ephemeris import LIGHT_KM_S, PLANETS, bodies_at, earth_motion, teme_from_icrs
from gss.catalogue_tools.envelope.orbits import jyear_of, read_tle
from gss.domain.aberration import aberrate
from gss.domain.angles import ARCSEC_RAD, Array, separation_rad
from gss.domain.errors import BadInput
from gss.orbit.read_orbit import MAX_CHARACTERS
from gss.orbit.station import GroundStation
from gss.orbit.trajectory import DAY_S, UNIX_EPOCH_JD, Trajectory, teme_from_fixed, unix_s

OLDEST_DAYS = 30.0
"""Maximum difference between a time and the epoch of elements that are used for identification."""
ERROR_KM, ERROR_KM_DAY = 2.0, 1.5
"""Assumed 1σ position error of a public element set at its epoch, and its growth per day (Vallado & Cefola 2012: 1 to 3 km at
epoch in low orbits)."""
PLANET_RAD = 60 * ARCSEC_RAD
"""Error of the series for the directions of planets."""
GATE_SIGMA = 3.0
MIN_RAD = 5 * ARCSEC_RAD


@dataclass(frozen=True)
class OrbitingObject:
    """An element set with its name and catalogue number."""

    name: str
    number: str
    satellite: Satrec
    epoch: datetime


@dataclass(frozen=True)
class MeasuredTrack:
    """Measured directions of one object. ``times_s``: (n,) Unix seconds. ``icrs``: (n, 3) directions in the system of the star
    catalogue. ``sigma_rad``: (n,) standard deviations. ``observer_km``: (n, 3) positions of the observer from the Earth's centre
    in ICRS axes, None if unknown."""

    times_s: Array
    icrs: Array
    sigma_rad: Array
    observer_km: Array | None


@dataclass(frozen=True)
class TrackName:
    """Identification of a track. ``number``: catalogue number, "" for a planet. ``off_rad``: mean angle between measured and
    predicted directions. ``range_km``: distance of the object, NaN for a planet. ``others``: names of other objects within the
    gate."""

    name: str
    number: str
    off_rad: float
    range_km: float
    others: tuple[str, ...] = ()


def read_objects(text: str) -> list[OrbitingObject]:
    """Read two-line element sets, with or without name lines. Raises BadInput that names the invalid element set."""
    if len(text) > MAX_CHARACTERS:
        raise BadInput(
            "the list of objects is too large",
            expected=f"at most {MAX_CHARACTERS} characters",
            got=str(len(text)),
            hint="Remove objects that cannot be in view.",
        )
    lines = [line.rstrip() for line in text.lstrip("\ufeff").splitlines() if line.strip()]
    objects: list[OrbitingObject] = []
    title = ""
    k = 0
    while k < len(lines):
        if not lines[k].startswith("1 ") or k + 1 == len(lines) or not lines[k + 1].startswith("2 "):
            if title or lines[k].startswith(("1 ", "2 ")):
                raise BadInput(
                    "the list of objects is not valid", expected="a name, line 1 and line 2", got=lines[k][:60]
                )
            title = lines[k].removeprefix("0 ").strip()
            k += 1
            continue
        try:
            satellite = read_tle("\n".join(lines[k : k + 2]))
        except BadInput as error:
            raise BadInput(
                f"element set {len(objects) + 1} of the list is not valid",
                expected="the two lines of a TLE",
                got=str(error)[:200],
            ) from None
        number = lines[k][2:7].strip()
        objects.append(
            OrbitingObject(
                title[:40] or f"object {number}", number, satellite, sat_epoch_datetime(satellite).astimezone(UTC)
            )
        )
        title = ""
        k += 2
    if title:
        raise BadInput("the list of objects is not valid", expected="line 1 and line 2 after a name", got=title[:60])
    return objects


@dataclass(frozen=True)
class ObjectCatalogue:
    """Catalogue of objects. The directions of all objects are computed together."""

    objects: tuple[OrbitingObject, ...]

    @cached_property
    def _array(self) -> SatrecArray:
        return SatrecArray([o.satellite for o in self.objects])

    @cached_property
    def _epochs_s(self) -> Array:
        return np.array([unix_s(o.epoch) for o in self.objects])

    def seen_from(self, times_s: Array, observer_km: Array) -> tuple[Array, Array]:
        """Return (m, n, 3) unit vectors in ICRS axes from (n, 3) positions at (n,) Unix seconds to the m objects, and (m, n)
        distances in km. The directions include the light travel time. NaN if elements are too old or have no orbit."""
        seconds = np.asarray(times_s, float)
        days = np.floor(seconds / DAY_S)
        errors, teme_km, teme_km_s = self._array.sgp4(UNIX_EPOCH_JD + days, seconds / DAY_S - days)
        teme_km[errors != 0] = np.nan
        teme_km[np.abs(self._epochs_s[:, None] - seconds) > OLDEST_DAYS * DAY_S] = np.nan
        icrs_from_teme = _teme_from_icrs(seconds).T
        to_object_km = teme_km @ icrs_from_teme.T - observer_km
        travel_s = np.linalg.norm(to_object_km, axis=2) / LIGHT_KM_S
        to_object_km -= (teme_km_s @ icrs_from_teme.T) * travel_s[..., None]
        distance_km = np.linalg.norm(to_object_km, axis=2)
        return to_object_km / distance_km[..., None], distance_km


def name_of(track: MeasuredTrack, catalogue: ObjectCatalogue) -> TrackName | None:
    """Identify a track as a planet, or as the catalogue object that is within the gate at all times of the track. Return None if
    there is none.

    The aberration by the Earth's motion displaces the stars, but not an object that moves with the Earth. It is removed
    from directions relative to catalogue stars, either by a correction or by the attitude, which follows the
    displaced stars. Therefore it is also removed from the predictions.
    """
    picked = np.unique(np.linspace(0, len(track.times_s) - 1, 3).round().astype(int))
    times_s, icrs, sigma = track.times_s[picked], track.icrs[picked], track.sigma_rad[picked]
    moment = datetime.fromtimestamp(float(times_s.mean()), UTC)
    observer_km = None if track.observer_km is None else track.observer_km[picked]
    bodies = bodies_at(jyear_of(moment), None if observer_km is None else observer_km.mean(axis=0))
    angle_rad = separation_rad(bodies.planets_icrs[:, None], icrs[None])
    planet = int(angle_rad.mean(axis=1).argmin())
    if (angle_rad[planet] < GATE_SIGMA * sigma + PLANET_RAD).all():
        return TrackName(PLANETS[planet], "", float(angle_rad[planet].mean()), float("nan"))
    if observer_km is None or not catalogue.objects:
        return None
    directions, distance_km = catalogue.seen_from(times_s, observer_km)
    velocity_c = earth_motion(jyear_of(moment))[1]
    directions = aberrate(directions.reshape(-1, 3), -velocity_c).reshape(directions.shape)
    angle_rad = separation_rad(directions, icrs[None])
    age_days = np.array([abs(unix_s(o.epoch) - float(times_s.mean())) for o in catalogue.objects]) / DAY_S
    error_rad = ((ERROR_KM + ERROR_KM_DAY * age_days)[:, None]) / distance_km
    gate = np.maximum(GATE_SIGMA * np.hypot(sigma[None], error_rad), MIN_RAD)
    inside = np.flatnonzero((angle_rad < gate).all(axis=1))
    if not len(inside):
        return None
    order = inside[np.argsort((angle_rad / gate)[inside].max(axis=1))]
    best = catalogue.objects[order[0]]
    others = tuple(catalogue.objects[k].name for k in order[1:4])
    return TrackName(
        best.name, best.number, float(angle_rad[order[0]].mean()), float(distance_km[order[0]].mean()), others
    )


def places_of_orbit(orbit: Trajectory, times_s: Array) -> Array:
    """Return (n, 3) positions of a spacecraft, km from the Earth's centre in ICRS axes, at (n,) Unix seconds. Raises BadInput
    outside the validity of the orbit."""
    return orbit.teme_km(times_s) @ _teme_from_icrs(times_s)


def places_of_station(station: GroundStation, times_s: Array) -> Array:
    """Return (n, 3) positions of a ground station, km from the Earth's centre in ICRS axes, at (n,) Unix seconds."""
    fixed = np.broadcast_to(station.position_km, (len(times_s), 3))
    return teme_from_fixed(fixed, times_s) @ _teme_from_icrs(times_s)


def _teme_from_icrs(times_s: Array) -> Array:
    """Return the (3, 3) rotation at the mean of (n,) Unix seconds. It changes by 0.15″ per day."""
    return teme_from_icrs(jyear_of(datetime.fromtimestamp(float(np.mean(times_s)), UTC)))


def catalogue_of(objects: Sequence[OrbitingObject]) -> ObjectCatalogue:
    """Return the objects as a catalogue."""
    return ObjectCatalogue(tuple(objects))

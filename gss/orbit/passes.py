"""Passes of a spacecraft over a ground station: times and directions of rise, culmination and set, and illumination by the
Sun."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from gss.catalogue_tools.corrections.ephemeris import SUN_RADIUS_KM
from gss.catalogue_tools.envelope.ellipse import EARTH_RADIUS_M
from gss.domain.angles import Array
from gss.orbit.station import GroundStation
from gss.orbit.trajectory import Trajectory, earth_fixed_km, fixed_from_teme, sun_teme_km, unix_s

STEP_S = 30.0
"""Step of the coarse search. In every orbit, the elevation changes smoothly over this time. Maxima between two steps
are refined."""
TOLERANCE_S = 0.01
TRACK_POINTS = 41


@dataclass(frozen=True)
class TrackPoint:
    """Direction to the spacecraft at one time. ``range_km``: distance. ``sunlit``: True if at least part of the Sun is visible from
    the spacecraft."""

    at: datetime
    azimuth_rad: float
    elevation_rad: float
    range_km: float
    sunlit: bool


@dataclass(frozen=True)
class OrbitPass:
    """One pass. ``track``: directions from rise to set, including both. ``begins_before``, ``ends_after``: True if the spacecraft
    is in view at the start or end of the searched time span; ``rise`` or ``set`` is then the limit of the span.
    ``sun_elevation_rad``: elevation of the Sun at the station at culmination. ``sunlit_share``: fraction of the pass in which the
    spacecraft is outside the Earth's shadow."""

    station: str
    rise: datetime
    culmination: datetime
    set: datetime
    max_elevation_rad: float
    rise_azimuth_rad: float
    culmination_azimuth_rad: float
    set_azimuth_rad: float
    sun_elevation_rad: float
    sunlit_share: float
    begins_before: bool
    ends_after: bool
    track: tuple[TrackPoint, ...]

    @property
    def duration_s(self) -> float:
        """Seconds from rise to set."""
        return (self.set - self.rise).total_seconds()


@dataclass(frozen=True)
class NextPass:
    """The current or next pass. ``at``: None if there is none; ``problem`` then states the reason."""

    at: OrbitPass | None
    problem: str = ""


def find_passes(orbit: Trajectory, station: GroundStation, start: datetime, end: datetime) -> list[OrbitPass]:
    """Return the passes that begin or are in progress in the time span, in order of rise. If a high part of the horizon mask
    or a gap of an ephemeris interrupts a pass, it is returned as two passes. Raises BadInput if the orbit is not valid in the
    time span."""
    spans = [(max(unix_s(start), first_s), min(unix_s(end), last_s)) for first_s, last_s in orbit.spans]
    spans = [(first_s, last_s) for first_s, last_s in spans if first_s < last_s]
    if not spans:
        orbit.teme_km(np.array([unix_s(start)]))  # raises the error that names the valid span
    return [at for first_s, last_s in spans for at in _passes_of_span(orbit, station, first_s, last_s)]


def _passes_of_span(orbit: Trajectory, station: GroundStation, first_s: float, last_s: float) -> list[OrbitPass]:
    """Return the passes between two Unix seconds between which the orbit has no gap."""

    def clearance(seconds: Array) -> Array:
        azimuth, elevation, _ = station.look(earth_fixed_km(orbit, seconds))
        return np.asarray(elevation - station.horizon_rad(azimuth))

    # Samples are at integer multiples of the step, so that the times of a pass do not depend on the searched span.
    inside_s = np.arange(np.floor(first_s / STEP_S) + 1, np.ceil(last_s / STEP_S)) * STEP_S
    times_s = np.concatenate([[first_s], inside_s, [last_s]])
    values = clearance(times_s)
    times_s, values = _with_maxima(clearance, times_s, values)
    above = values > 0
    edges = np.flatnonzero(above[1:] != above[:-1])
    crossings = [_crossing(clearance, times_s[k], times_s[k + 1]) for k in edges]
    if above[0]:
        crossings.insert(0, first_s)
    if above[-1]:
        crossings.append(last_s)
    pairs = list(zip(crossings[::2], crossings[1::2], strict=True))
    return [_pass(orbit, station, a, b, (a == first_s, b == last_s)) for a, b in pairs if b > a]


def _with_maxima(clearance: Callable[[Array], Array], times_s: Array, values: Array) -> tuple[Array, Array]:
    """Add samples at the maxima between steps, because a short pass can lie between two samples below the horizon."""
    peak = (values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:]) & (values[1:-1] <= 0)
    near = np.flatnonzero(peak & (values[1:-1] > np.radians(-5.0))) + 1
    maxima = np.array([_maximum(clearance, times_s[k - 1], times_s[k + 1]) for k in near])
    if not len(maxima):
        return times_s, values
    times_s, values = np.append(times_s, maxima), np.append(values, clearance(maxima))
    order = np.argsort(times_s, kind="stable")
    return times_s[order], values[order]


def _maximum(value_of: Callable[[Array], Array], low_s: float, high_s: float) -> float:
    """Return the Unix seconds of the largest value in an interval with one maximum, by successively finer sampling."""
    while high_s - low_s > TOLERANCE_S:
        times_s = np.linspace(low_s, high_s, 17)
        k = int(np.argmax(value_of(times_s)))
        low_s, high_s = times_s[max(0, k - 1)], times_s[min(16, k + 1)]
    return float(low_s + high_s) / 2


def _crossing(clearance: Callable[[Array], Array], low_s: float, high_s: float) -> float:
    """Return the Unix seconds of the change of sign between two times, by successively finer sampling."""
    while high_s - low_s > TOLERANCE_S:
        times_s = np.linspace(low_s, high_s, 17)
        above = clearance(times_s) > 0
        k = int(np.flatnonzero(above[1:] != above[:-1])[0])
        low_s, high_s = times_s[k], times_s[k + 1]
    return float(low_s + high_s) / 2


def _pass(orbit: Trajectory, station: GroundStation, rise_s: float, set_s: float, cut: tuple[bool, bool]) -> OrbitPass:
    top_s = _culmination(orbit, station, rise_s, set_s)
    times_s = np.sort(np.append(np.linspace(rise_s, set_s, TRACK_POINTS - 1), top_s))
    teme_km = orbit.teme_km(times_s)
    azimuth, elevation, range_km = station.look(fixed_from_teme(teme_km, times_s))
    sun_km = sun_teme_km(_moment(top_s))
    sunlit = sunlit_at(teme_km, sun_km)
    track = tuple(
        TrackPoint(_moment(t), float(a), float(e), float(r), bool(s))
        for t, a, e, r, s in zip(times_s, azimuth, elevation, range_km, sunlit, strict=True)
    )
    top = track[int(np.argmax(elevation))]
    sun = station.look(fixed_from_teme(sun_km[None], np.array([top_s])))[1]
    return OrbitPass(
        station=station.name,
        rise=track[0].at,
        culmination=top.at,
        set=track[-1].at,
        max_elevation_rad=top.elevation_rad,
        rise_azimuth_rad=track[0].azimuth_rad,
        culmination_azimuth_rad=top.azimuth_rad,
        set_azimuth_rad=track[-1].azimuth_rad,
        sun_elevation_rad=float(sun[0]),
        sunlit_share=float(np.mean(sunlit)),
        begins_before=cut[0],
        ends_after=cut[1],
        track=track,
    )


def _culmination(orbit: Trajectory, station: GroundStation, rise_s: float, set_s: float) -> float:
    """Return the Unix seconds of the highest elevation."""

    def elevation(seconds: Array) -> Array:
        return station.look(earth_fixed_km(orbit, seconds))[1]

    times_s = np.linspace(rise_s, set_s, max(17, int((set_s - rise_s) / STEP_S) + 1))
    k = int(np.argmax(elevation(times_s)))
    return _maximum(elevation, times_s[max(0, k - 1)], times_s[min(len(times_s) - 1, k + 1)])


def sunlit_at(teme_km: Array, sun_km: Array) -> Array:
    """Return an (n,) mask that is True if part of the Sun is visible from the (n, 3) position, that is, if the disc of the Earth
    does not hide the disc of the Sun completely (Montenbruck & Gill 2000 §3.4.2, spherical Earth)."""
    to_sun = sun_km - teme_km
    sun_range, earth_range = np.linalg.norm(to_sun, axis=1), np.linalg.norm(teme_km, axis=1)
    sun_radius = np.arcsin(SUN_RADIUS_KM / sun_range)
    earth_radius = np.arcsin(np.minimum(1.0, EARTH_RADIUS_M / 1000.0 / earth_range))
    between = np.arccos(np.clip(np.sum(-teme_km * to_sun, axis=1) / sun_range / earth_range, -1.0, 1.0))
    return np.asarray(between > earth_radius - sun_radius)


def _moment(seconds: float) -> datetime:
    """Return Unix seconds as UTC, rounded to the millisecond."""
    return datetime.fromtimestamp(round(float(seconds), 3), UTC)

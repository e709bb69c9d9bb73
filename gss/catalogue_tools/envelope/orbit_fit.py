"""Comparison of a satellite's orbit with the orbital planes for which a catalogue was built."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from gss.catalogue_tools.envelope.orbits import OrbitRanges, from_tle
from gss.domain.angles import Array, wrap_pi_rad

DRIFT_DAYS = 1.0
"""Time over which the drift of the node is computed. It is then extrapolated linearly."""
LOOK_DAYS, STEP_DAYS = 366.0, 0.05


@dataclass(frozen=True)
class OrbitFit:
    """``outside_rad``: angle by which the satellite's orbital plane is outside the planes of the catalogue at present, 0 inside.
    ``leaves``: time at which the angle exceeds the margin; None if the plane is outside already, or inside for a year."""

    outside_rad: float
    inside: bool
    leaves: datetime | None


def orbit_fit(planes: OrbitRanges, margin_rad: float, tle: str, at: datetime) -> OrbitFit:
    """Return how the plane of a satellite fits a catalogue at a time and until it leaves the catalogue's planes.

    ``margin_rad``: margin by which the catalogue's field was widened. A plane that is outside by less moves each star by
    less than this margin. Raises BadInput if the TLE is not valid at ``at``.
    """
    present = from_tle(tle, at, DRIFT_DAYS)
    days = np.arange(0.0, LOOK_DAYS, STEP_DAYS)
    outside = _outside_rad(planes, float(np.mean(present.inclination_rad)), present.raan_at(days / DRIFT_DAYS))
    beyond = np.flatnonzero(outside > margin_rad)
    inside = bool(outside[0] <= margin_rad)
    leaves = at + timedelta(days=float(days[beyond[0]])) if inside and len(beyond) else None
    return OrbitFit(float(outside[0]), inside, leaves)


def _outside_rad(planes: OrbitRanges, inclination_rad: float, raan_rad: Array) -> Array:
    """Return the (n,) angles between planes and the nearest plane of the ranges, for small angles."""
    low, high = planes.raan_rad
    from_middle = np.abs(wrap_pi_rad(raan_rad - (low + high) / 2))
    node = np.maximum(0.0, from_middle - (high - low) / 2) * np.sin(inclination_rad)
    lowest, highest = planes.inclination_rad
    return np.asarray(np.hypot(max(0.0, lowest - inclination_rad, inclination_rad - highest), node))

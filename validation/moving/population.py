"""A population of satellites as element sets, and an observer in a low orbit."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from sgp4.api import WGS72, Satrec
from sgp4.exporter import export_tle

from gss.domain.angles import Array
from gss.orbit.objects import ObjectCatalogue, catalogue_of, places_of_orbit, read_objects
from gss.orbit.trajectory import TleTrajectory

EPOCH = datetime(2026, 3, 1, tzinfo=UTC)
SGP4_EPOCH_DAYS = (EPOCH - datetime(1949, 12, 31, tzinfo=UTC)).days
EARTH_KM, EARTH_KM3_S2 = 6378.135, 398600.8
GEO_KM = 42164.0
HIGH_SHARE = 0.2
OBSERVER_KM = 6978.0


@dataclass(frozen=True)
class Population:
    """Element sets of a population. ``text``: all sets as text. ``catalogue``: the same sets, parsed. ``observer``:
    elements of the observer."""

    text: str
    catalogue: ObjectCatalogue
    observer: str

    def single(self, row: int) -> ObjectCatalogue:
        """Return a catalogue of the object in one row."""
        return catalogue_of([self.catalogue.objects[row]])


def population(count: int, rng: np.random.Generator) -> Population:
    """Return ``count`` objects. A fifth of them are near the geostationary ring, the others in low orbits of 500 to
    1500 km."""
    parts = []
    for number in range(count):
        high = rng.random() < HIGH_SHARE
        axis_km = GEO_KM + rng.normal(0, 30) if high else EARTH_KM + rng.uniform(500, 1500)
        inclination = rng.uniform(0, 0.26) if high else np.arccos(rng.uniform(-0.3, 0.9))
        lines = element_set(70_000 + number, axis_km, float(inclination), rng)
        parts.append(f"SIM {number}\n{lines}\n")
    text = "".join(parts)
    return Population(text, catalogue_of(read_objects(text)), element_set(69_999, OBSERVER_KM, 1.70, rng))


def element_set(number: int, axis_km: float, inclination_rad: float, rng: np.random.Generator) -> str:
    """Return the two lines of a nearly circular orbit with random node, perigee and anomaly."""
    motion_rad_min = float(np.sqrt(EARTH_KM3_S2 / axis_km**3) * 60)
    node, perigee, anomaly = rng.uniform(0, 2 * np.pi, 3)
    satellite = Satrec()
    satellite.sgp4init(
        WGS72,
        "i",
        number,
        float(SGP4_EPOCH_DAYS),
        0.0,
        0.0,
        0.0,
        float(rng.uniform(1e-4, 3e-3)),
        float(perigee),
        inclination_rad,
        float(anomaly),
        motion_rad_min,
        float(node),
    )
    satellite.classification, satellite.intldesg = "U", "26001A"
    satellite.ephtype, satellite.elnum, satellite.revnum = 0, 1, 1
    return "\n".join(export_tle(satellite))


def observer_km(elements: str, times_s: Array) -> Array:
    """Return the (n, 3) positions of the observer, km, ICRS axes."""
    return places_of_orbit(TleTrajectory.of(elements), times_s)

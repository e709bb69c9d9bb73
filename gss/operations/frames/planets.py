"""Names of planets in a solved frame.

A chain has no planets in its catalogue, so it leaves them unmatched. If the time of exposure is known, their positions
are computed and compared with the unmatched stars (Moniteq 1983 §2.3). The document limits this check to bright stars
near the ecliptic to save time; here it is made for every frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime

import numpy as np

from gss.catalogue_tools.corrections.ephemeris import PLANETS, bodies_at
from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.domain.aberration import aberrate
from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.operations.frames.overlay import StarOverlay

NEAR_RAD = math.radians(1 / 60)
"""Maximum distance of a planet from its computed position, in addition to NEAR_PX. The position of the observer on or near
the Earth, which is not known, has an effect of at most 34″ (Venus at its smallest distance)."""
NEAR_PX = 2.0


def with_planets(
    stars: Sequence[StarOverlay],
    camera: Camera,
    cam_from_icrs: Array,
    velocity_c: tuple[float, float, float] | None,
    taken: datetime,
) -> list[StarOverlay]:
    """Return the stars of a frame, with name and magnitude of each planet that is on the detector and near an unmatched star.

    ``velocity_c``: velocity of the observer in units of c, None if the attitude was not corrected for aberration. If several
    unmatched stars are near a planet, the brightest is named.
    """
    named = list(stars)
    bodies = bodies_at(jyear_of(taken))
    directions = bodies.planets_icrs
    if velocity_c is not None:
        directions = aberrate(directions, np.array(velocity_c))
    pixels = camera.project(directions @ np.asarray(cam_from_icrs).T)
    within_px = NEAR_PX + NEAR_RAD / camera.pixel_rad
    for planet, position, v_mag in zip(PLANETS, pixels, bodies.planets_v_mag, strict=True):
        near = [
            k
            for k, star in enumerate(named)
            if "name" not in star and math.dist((star["col_px"], star["row_px"]), position) <= within_px
        ]
        if near:
            brightest = max(near, key=lambda k: named[k]["flux_dn"])
            named[brightest] = named[brightest] | {"name": planet, "v_mag": round(float(v_mag), 2)}
    return named

"""Predicted star positions over a frame taken from a moving spacecraft."""

from __future__ import annotations

import numpy as np
from astropy.coordinates import GCRS, ICRS, SkyCoord
from astropy.time import Time

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.results import Centroids
from gss.instruments.registry import shipped_camera
from gss.operations.frames.overlay import predicted

TIME = Time("2026-03-21T00:00:00", scale="utc")


def test_predicted_positions_include_the_observers_velocity() -> None:
    """Predicted positions equal those for astropy's geocentric observer. Without the velocity they differ by more than a
    quarter of a pixel."""
    camera = shipped_camera("sunsat").camera
    stars = propagate(load_stars(6.0), 2026.2)
    velocity_c = tuple(float(v) for v in earth_velocity_c())
    rows = predicted(camera, np.eye(3), stars, 6.0, Centroids.from_pixels(np.zeros((0, 2))), velocity_c)
    without_velocity = {
        r["hip"]: r for r in predicted(camera, np.eye(3), stars, 6.0, Centroids.from_pixels(np.zeros((0, 2))))
    }
    assert len(rows) > 5
    for row in rows:
        unit = stars.icrs[stars.row_of_hip[row["hip"]]]
        at = SkyCoord(*unit, representation_type="cartesian", frame=ICRS()).transform_to(GCRS(obstime=TIME))
        place = camera.project(at.cartesian.xyz.value[None])[0]
        assert np.hypot(row["col_px"] - place[0], row["row_px"] - place[1]) < 0.01
    shifts_px = [
        np.hypot(r["col_px"] - without_velocity[r["hip"]]["col_px"], r["row_px"] - without_velocity[r["hip"]]["row_px"])
        for r in rows
        if r["hip"] in without_velocity
    ]
    assert min(shifts_px) > 0.25


def earth_velocity_c() -> np.ndarray:
    """Return the Earth's velocity relative to the barycentre, in units of c."""
    from astropy.coordinates import get_body_barycentric_posvel

    return np.asarray(get_body_barycentric_posvel("earth", TIME)[1].xyz.to_value("km/s")) / 299792.458

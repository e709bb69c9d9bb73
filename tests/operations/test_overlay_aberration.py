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
    """Stars are drawn where astropy's geocentric observer sees them; without the velocity they are a quarter of a pixel
    off.
    """
    camera = shipped_camera("sunsat").camera
    stars = propagate(load_stars(6.0), 2026.2)
    velocity_c = tuple(float(v) for v in earth_velocity_c())
    rows = predicted(camera, np.eye(3), stars, 6.0, Centroids.from_pixels(np.zeros((0, 2))), velocity_c)
    still = {r["hip"]: r for r in predicted(camera, np.eye(3), stars, 6.0, Centroids.from_pixels(np.zeros((0, 2))))}
    assert len(rows) > 5
    for row in rows:
        unit = stars.icrs[stars.row_of_hip[row["hip"]]]
        at = SkyCoord(*unit, representation_type="cartesian", frame=ICRS()).transform_to(GCRS(obstime=TIME))
        place = camera.project(at.cartesian.xyz.value[None])[0]
        assert np.hypot(row["col_px"] - place[0], row["row_px"] - place[1]) < 0.01
    apart = [
        np.hypot(r["col_px"] - still[r["hip"]]["col_px"], r["row_px"] - still[r["hip"]]["row_px"])
        for r in rows
        if r["hip"] in still
    ]
    assert min(apart) > 0.25


def earth_velocity_c() -> np.ndarray:
    """The Earth's velocity relative to the barycentre, in units of c."""
    from astropy.coordinates import get_body_barycentric_posvel

    return np.asarray(get_body_barycentric_posvel("earth", TIME)[1].xyz.to_value("km/s")) / 299792.458

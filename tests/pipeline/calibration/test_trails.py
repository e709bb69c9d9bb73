"""Trails of a moving camera, measured in rendered exposures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.camera_profile import CameraProfile
from gss.domain.frames import cam_from_icrs
from gss.domain.results import Centroids
from gss.pipeline.calibration.trails import trail_px
from gss.pipeline.detect import find_stars
from gss.pipeline.render import render

ProfileOf = Callable[[str], CameraProfile]


@pytest.mark.parametrize(("length_px", "bearing"), [(0.0, 0.0), (6.0, 0.4), (10.0, 2.2)])
def test_length_of_trails_is_measured(length_px: float, bearing: float, profile_of: ProfileOf) -> None:
    """Round stars have no trail. The length of trails in any direction is measured within 30 %."""
    profile = profile_of("far_mst")
    exposure_s = profile.sensor.exposure_s
    rate = length_px * profile.camera.pixel_rad / exposure_s * np.array([np.cos(bearing), np.sin(bearing), 0.0])
    attitude = cam_from_icrs(1.4, 0.0, 0.3)
    picture = render(
        load_stars(6.0), profile.camera, profile.sensor, attitude, exposure_s, np.random.default_rng(1), rate_rad_s=rate
    )
    centroids = find_stars(picture.pixels, saturation_dn=float(profile.sensor.saturation_dn)).centroids
    assert len(centroids) >= 8
    assert trail_px(picture.pixels, centroids, float(profile.sensor.saturation_dn)) == pytest.approx(length_px, rel=0.3)


def test_too_few_stars_give_no_trail(profile_of: ProfileOf) -> None:
    """No stars, three stars and positions in noise give a trail length of zero."""
    image = np.random.default_rng(2).poisson(50, (200, 200)).astype(np.uint16)
    assert trail_px(image, Centroids.from_pixels(np.empty((0, 2)))) == 0.0
    assert trail_px(image, Centroids.from_pixels(np.full((3, 2), 50.0))) == 0.0
    assert trail_px(image, Centroids.from_pixels(np.random.default_rng(3).uniform(20, 180, (20, 2)))) == 0.0

"""Focus and sensitivity of a camera that rotates during the exposure."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains import reference
from gss.pipeline.health.frame_figures import HealthFrame, frame_figures, lost_light_mag, over_sky
from gss.pipeline.identify.verify import SkyCatalogue
from gss.pipeline.render import render


def test_a_rotation_is_neither_defocus_nor_lost_light() -> None:
    """Trails of 2 and 10 px, whose rotation is and is not measured, change neither the width of the stars nor their light."""
    profile = shipped_camera("sagitta")
    camera, sensor, exposure_s = profile.camera, profile.sensor, profile.sensor.exposure_s
    stars = load_stars(sensor.faint_limit_mag + 1)
    catalogue = SkyCatalogue(stars.hip, stars.icrs, stars.v_mag)
    sky = reference.known_sky(catalogue, camera, sensor.faint_limit_mag)
    attitude = matrix_from_quaternion(random_quaternion(np.random.default_rng(3)))
    lost_mag = []
    for trail_px in (0.0, 2.0, 10.0):
        rate_rad_s = (0.0, trail_px * camera.pixel_rad / exposure_s, 0.0)
        noise = np.random.default_rng(4)
        pixels = render(stars, camera, sensor, attitude, exposure_s, noise, rate_rad_s=rate_rad_s).pixels
        result = reference.solve_known(pixels, camera, sensor, sky, exposure_s=exposure_s)
        assert (result.turning is not None) == (trail_px > 3)
        frame = HealthFrame("frame", 0.0, exposure_s, pixels.view, result, stars)
        sky_of_frame = over_sky(frame, pixels, sensor)
        figures = frame_figures(frame, pixels, sky_of_frame, camera, sensor)
        assert figures["PSF width"][0] == pytest.approx(sensor.psf_sigma_px, rel=0.03)
        lost, _ = lost_light_mag(result, frame, sky_of_frame.excess_dn, sky_of_frame.noise_dn, sensor)
        lost_mag.append(float(np.median(lost)))
    assert np.abs(lost_mag).max() < 0.03

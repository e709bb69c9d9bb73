"""What a calibration finds goes into the device's table and comes back as the same camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.device.table_use import calibrated, calibration_values
from gss.domain.camera import Brown, Distortion, Pinhole, RadialTilt
from gss.domain.errors import BadInput
from gss.domain.profiles import PROFILES, profile
from gss.pipeline.calibration.apply import DetectorFigures, calibrated_profile

LENSES: tuple[Distortion, ...] = (
    Pinhole(),
    Brown(-0.31, 0.11),
    Brown(0.02, -0.4, -2e-3, 3e-4, 0.1),
    RadialTilt(25.0, 0.0, 0.0, (0.0, -4e-4, -3e-4)),
    RadialTilt(25.0, 0.011, 3.9, (1e-3, 2e-4, 0.0)),
)


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("lens", LENSES)
def test_every_lens_model_fits_every_units_table(name: str, lens: Distortion) -> None:
    """A term that a calibration does without, or finds of the other sign, is no mistake; the camera is the same again."""
    own = profile(name)
    camera = replace(own.camera.with_focal_scaled(1.004), distortion=lens, centre_col_px=own.camera.centre_col_px + 7)
    made = calibrated_profile(own, camera, detector=DetectorFigures(psf_sigma_px=1.1))
    back = calibrated(own, calibration_values(made))
    assert back.sensor == made.sensor
    pixels = np.array([[10.0, 20.0], [own.camera.columns / 2, own.camera.rows - 5.0]])
    assert np.allclose(back.camera.unproject(pixels), camera.unproject(pixels), atol=1e-12)


def test_coefficients_beyond_reason_are_still_refused() -> None:
    """A hundredfold is a mistake with either sign."""
    own = profile("cubestar")
    for k1 in (40.0, -40.0):
        values = calibration_values(replace(own, camera=replace(own.camera, distortion=Brown(k1))))
        with pytest.raises(BadInput, match="k1 cannot be right"):
            calibrated(own, values)

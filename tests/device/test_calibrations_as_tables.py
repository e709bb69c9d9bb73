"""A calibration stored in the device's table gives the same camera when it is read back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.device.table_use import calibrated, calibration_values
from gss.domain.camera import Brown, Distortion, Pinhole, RadialTilt
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.calibration.apply import DetectorFigures, calibrated_profile

LENSES: tuple[Distortion, ...] = (
    Pinhole(),
    Brown(-0.31, 0.11),
    Brown(0.02, -0.4, -2e-3, 3e-4, 0.1),
    RadialTilt(25.0, 0.0, 0.0, (0.0, -4e-4, -3e-4)),
    RadialTilt(25.0, 0.011, 3.9, (1e-3, 2e-4, 0.0)),
)


@pytest.mark.parametrize("name", [i.name for i in shipped_registry().all() if i.profile.chain])
@pytest.mark.parametrize("lens", LENSES)
def test_every_lens_model_fits_every_units_table(name: str, lens: Distortion) -> None:
    """Coefficients that are zero or have the opposite sign are valid. The camera read from the table is the same."""
    nominal = shipped_camera(name)
    camera = replace(
        nominal.camera.with_focal_scaled(1.004), distortion=lens, centre_col_px=nominal.camera.centre_col_px + 7
    )
    calibration = calibrated_profile(nominal, camera, detector=DetectorFigures(psf_sigma_px=1.1))
    restored = calibrated(nominal, calibration_values(calibration))
    assert restored.sensor == calibration.sensor
    pixels = np.array([[10.0, 20.0], [nominal.camera.columns / 2, nominal.camera.rows - 5.0]])
    assert np.allclose(restored.camera.unproject(pixels), camera.unproject(pixels), atol=1e-12)


def test_a_missing_radial_coefficient_is_zero() -> None:
    """The coefficients after a missing one keep their powers of the radius."""
    nominal = shipped_camera("sunsat")
    values = calibration_values(nominal)
    lens = calibrated(nominal, {name: value for name, value in values.items() if name != "radial_1"}).camera.distortion
    assert isinstance(lens, RadialTilt)
    assert lens.radial == (0.0, values["radial_2"], values["radial_3"])


def test_implausible_coefficients_are_rejected() -> None:
    """A coefficient about 100 times too large is rejected, with either sign."""
    nominal = shipped_camera("cubestar")
    for k1 in (40.0, -40.0):
        values = calibration_values(replace(nominal, camera=replace(nominal.camera, distortion=Brown(k1))))
        with pytest.raises(BadInput, match="k1 is implausible"):
            calibrated(nominal, values)

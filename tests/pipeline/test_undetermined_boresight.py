"""Rejection of attitudes whose boresight the identified stars do not determine."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.proof import undetermined
from gss.pipeline.chains.sunsat import triad_covariance_rad2

CAMERA = shipped_camera("sunsat").camera
# Five Pleiades in a corner of Sunsat's field, all identified correctly, in a frame of `shipped-units` (frame of 1000 with
# seed 1). Unresolved companions displaced the centroids by half a pixel, and the boresight was 6.5 px off.
PLEIADES_PX = np.array([[92.15, 42.63], [100.01, 68.33], [69.47, 20.64], [98.78, 22.23], [60.97, 12.61]])
RESIDUAL_PX = np.array([[0.368, -0.335], [-0.138, -0.216], [0.0, 0.0], [0.109, -0.451], [-0.056, 0.240]])
SIGMA_PX = np.array([0.0321, 0.0427, 0.0393, 0.0434, 0.0445])


def _covariance(first_px: list[float], second_px: list[float]) -> Array:
    unit = CAMERA.unproject(np.array([first_px, second_px]))
    sigma_rad = 0.04 * CAMERA.pixel_rad
    return triad_covariance_rad2(unit[0], unit[1], sigma_rad, sigma_rad)


def test_stars_close_together_with_large_residuals_are_rejected() -> None:
    """The boresight error of this frame is recognised, although every star fits within half a pixel."""
    covariance = _covariance(PLEIADES_PX[2].tolist(), PLEIADES_PX[1].tolist())
    assert "boresight could be" in undetermined(covariance, RESIDUAL_PX, SIGMA_PX, CAMERA)


def test_the_same_stars_without_displacement_are_accepted() -> None:
    """Residuals of the size of the noise give no objection."""
    covariance = _covariance(PLEIADES_PX[2].tolist(), PLEIADES_PX[1].tolist())
    assert undetermined(covariance, RESIDUAL_PX / 10, SIGMA_PX, CAMERA) == ""


def test_large_residuals_of_stars_over_the_whole_field_are_accepted() -> None:
    """A displacement of half a pixel is harmless if the pair of TRIAD spans the field."""
    assert undetermined(_covariance([60.0, 60.0], [690.0, 520.0]), RESIDUAL_PX, SIGMA_PX, CAMERA) == ""


def test_a_star_outside_the_lens_model_gives_its_own_reason() -> None:
    """Its residual is NaN, and so is the error of the boresight."""
    residual_px = np.vstack([RESIDUAL_PX[:-1], [np.nan, np.nan]])
    covariance = _covariance([60.0, 60.0], [690.0, 520.0])
    assert "lens model" in undetermined(covariance, residual_px, SIGMA_PX, CAMERA)

"""Expected accuracy compared with the scatter of least-squares solutions."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.design import accuracy
from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.design.in_view import bright_rows, look, pairs_in_view
from gss.catalogue_tools.design.radiometry import limit_mag, saturation_mag
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.registry import shipped_camera
from gss.pipeline.attitude import quest

STARS = load_stars(8.0)


def scatter_rad(camera: DesignCamera, attitude: np.ndarray, rows: int, trials: int, seed: int) -> tuple[float, float]:
    """Return the standard deviations (across, about the boresight) of QUEST over noisy pixels of the stars visible at
    one attitude.
    """
    rng = np.random.default_rng(seed)
    unit = STARS.icrs[:rows]
    visible = np.flatnonzero(camera.shape.inside(unit @ attitude.T))
    sigma = accuracy.star_sigma_px(camera, STARS, rows)[visible]
    pixels = camera.camera.project(unit[visible] @ attitude.T)
    errors = []
    for _ in range(trials):
        noisy = camera.camera.unproject(pixels + sigma[:, None] * rng.normal(size=pixels.shape))
        solved = matrix_from_quaternion(quest(noisy, unit[visible], 1 / sigma**2))
        rotation = solved @ attitude.T
        errors.append(
            [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
        )
    x, y, z = np.std(np.array(errors) / 2, axis=0)
    return float(np.hypot(x, y) / np.sqrt(2)), float(z)


@pytest.mark.parametrize("name", ["sunsat", "far_mst"])
def test_expected_accuracy_agrees_with_the_scatter_of_quest(name: str) -> None:
    """For three attitudes the predicted σ across and about the boresight agrees with the scatter of QUEST within 12 %."""
    camera = DesignCamera.from_profile(shipped_camera(name))
    rows = bright_rows(STARS, limit_mag(camera))
    attitudes = look(camera, 3, 11)
    pairs = pairs_in_view(STARS.icrs[:rows], attitudes, camera.shape)
    across, about = accuracy.sigma_rad(camera, pairs, accuracy.star_sigma_px(camera, STARS, rows))
    for k, attitude in enumerate(attitudes):
        scatter = scatter_rad(camera, attitude, rows, 300, k)
        assert scatter == pytest.approx((across[k], about[k]), rel=0.12)


def test_roll_error_is_the_cross_error_over_the_lever_arm() -> None:
    """For stars on a ring of tangent radius t, the roll error is 1/t times the cross-boresight error within 2 %
    (Huffman §7.2).
    """
    camera = DesignCamera.from_profile(shipped_camera("sunsat"))
    angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    t = 0.07
    plane = t * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    pairs = accuracy.StarsInFields(np.zeros(8, np.intp), np.arange(8), plane, np.array([8]))
    square = camera.edited(pitch_row_um=camera.pitch_col_um)
    across, about = accuracy.sigma_rad(square, pairs, np.full(8, 0.1))
    assert about[0] / across[0] == pytest.approx(1 / t, rel=0.02)
    assert across[0] == pytest.approx(0.1 * square.camera.pixel_rad / np.sqrt(8), rel=0.02)


def test_too_few_stars_give_no_accuracy() -> None:
    """Two stars give no accuracy. Fields without accuracy reduce the stated share and raise no error."""
    camera = DesignCamera.from_profile(shipped_camera("sunsat"))
    pairs = accuracy.StarsInFields(
        np.zeros(2, np.intp), np.arange(2), np.array([[0.0, 0.05], [0.05, 0.0]]), np.array([2])
    )
    assert np.isnan(accuracy.sigma_rad(camera, pairs, np.full(2, 0.1))[0]).all()
    without_accuracy = accuracy.summary(np.array([np.nan]), np.array([np.nan]))
    assert without_accuracy.share == 0.0
    assert without_accuracy.cross_median_rad == np.inf
    assert np.isnan(without_accuracy.cross_mean_rad)
    half = accuracy.summary(np.array([1.0, 2.0, np.nan, np.nan]), np.array([3.0, 4.0, np.nan, np.nan]))
    assert (half.share, half.cross_median_rad, half.cross_mean_rad, half.cross_p95_rad) == (0.5, 2.0, 1.5, np.inf)


def test_longer_exposures_and_fainter_limits_increase_accuracy() -> None:
    """A longer exposure and a fainter limit decrease the noise-equivalent angle. A longer exposure also makes the limit
    fainter, unless the limit is given.
    """
    camera = DesignCamera.from_profile(shipped_camera("far_mst"))
    attitudes = look(camera, 60, 2)
    pairs = pairs_in_view(STARS.icrs, attitudes, camera.shape)
    times = camera.exposure_s * np.array([0.3, 1.0, 3.0])
    cross = [x.cross_median_rad for x in accuracy.against_exposure(camera, STARS, pairs, times)]
    assert cross == sorted(cross, reverse=True)
    by_limit = [x.cross_median_rad for x in accuracy.against_limit(camera, STARS, pairs, np.array([3.5, 4.5]))]
    assert by_limit[1] < by_limit[0]
    assert accuracy.limit_at_mag(camera, 3 * camera.exposure_s) > limit_mag(camera)
    with_given_limit = camera.edited(mag_limit=4.0)
    assert accuracy.limit_at_mag(with_given_limit, 3 * camera.exposure_s) == 4.0
    assert accuracy.limit_at_mag(with_given_limit, camera.exposure_s / 3) < 4.0


def test_a_saturated_star_has_the_error_of_a_star_at_the_limit() -> None:
    """In Sunsat's camera, Sirius has the centroid error of a star at the saturation limit."""
    camera = DesignCamera.from_profile(shipped_camera("sunsat"))
    sigma = accuracy.star_sigma_px(camera, STARS, 200)
    at_limit = int(np.searchsorted(STARS.v_mag, saturation_mag(camera)))
    assert sigma[0] == pytest.approx(sigma[at_limit], rel=0.02)

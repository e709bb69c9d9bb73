"""The stages of the AIM smart camera: mean locator, coarse mask, neighbour walk, guidance error, differential attitude
and two cameras.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.rotation import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    random_quaternion,
    rotation_angle_rad,
    rotation_from_vector,
)
from gss.pipeline.coarse_mask import coarse_image, coarse_mask, dark_mean_dn, windows_mask
from gss.pipeline.identify.neighbour_pattern import magnitude_fits
from gss.pipeline.identify.soundness import errors_objection, is_handed, separate_stars
from gss.pipeline.mean_locator import (
    DarkModel,
    bias_gain,
    location_error_px,
    mean_locations_px,
    noise_coefficients,
)
from gss.pipeline.render import spots
from gss.pipeline.track.cameras_together import CameraView, body_attitude
from gss.pipeline.track.constant_rate import (
    average_estimates,
    extrapolate,
)
from gss.pipeline.track.differential import differential_attitude
from gss.pipeline.track.least_distance import pair_least_distance
from gss.pipeline.track.link_walk import linear_search, walk
from gss.pipeline.track.predictor import rotation_vector_rad
from gss.pipeline.track.search_and_track import (
    raises_guidance_error,
)
from gss.skytables.neighbours import neighbour_links

# Moniteq 1983 Figs. 4.2–4.4, recalculated from the report's model: E/d by (d/σ, δ) for three and for two columns.
THREE = {(1.0, 0.1): -0.0487, (2.0, 0.25): -0.0127, (2.25, 0.5): -0.0186, (2.5, 0.3): -0.0152, (4.0, 0.2): -0.0875}
TWO = {(1.0, 0.1): -0.0770, (2.5, 0.5): -0.1180, (3.0, 0.25): 0.0206, (6.0, 0.2): 0.1849}


@pytest.mark.parametrize(("window", "table"), [(3, THREE), (2, TWO)])
def test_location_error_agrees_with_the_report(window: int, table: dict[tuple[float, float], float]) -> None:
    """The interpolation and truncation error, as a function of pixel size over σ and of the offset, agrees with the
    report to the last printed digit.
    """
    for (ratio, offset), error in table.items():
        assert location_error_px(offset, ratio, window) == pytest.approx(error, abs=1e-4)


def test_location_error_has_the_expected_limits() -> None:
    """A very wide star is located in the middle of the window, and a point star in the middle of its pixel. The error
    is an odd function of the offset.
    """
    assert location_error_px(0.3, 1e-3, 3) == pytest.approx(-0.3, abs=1e-3)
    assert location_error_px(0.3, 1e3, 3) == pytest.approx(-0.3, abs=1e-6)
    assert location_error_px(-0.2, 2.5, 3) == pytest.approx(-location_error_px(0.2, 2.5, 3))


@pytest.mark.parametrize(
    ("ratio", "gain", "remaining_px"), [(2.0, 1.063, 0.0056), (2.2, 1.042, 0.0008), (2.5, 1.0385, 0.0095)]
)
def test_the_bias_corrector_removes_most_of_the_error(ratio: float, gain: float, remaining_px: float) -> None:
    """The best factor and the largest remaining error agree with the expected ones: below 0.001 px at a ratio of 2.2."""
    offset = np.linspace(-0.5, 0.5, 101)
    measured = offset + location_error_px(offset, ratio, 3)
    assert bias_gain(ratio, 3) == pytest.approx(gain, abs=5e-4)
    assert np.max(np.abs(bias_gain(ratio, 3) * measured - offset)) == pytest.approx(remaining_px, abs=2e-4)


def test_noise_coefficients_agree_with_the_report() -> None:
    """The smallest C is 1, 6, 20 and 50 for 2 to 5 pixels, and A, B and C at a ratio of 2.5 agree with the recalculated
    values.
    """
    for window, smallest_c in ((2, 1), (3, 6), (4, 20), (5, 50)):
        assert noise_coefficients((0.0, 0.0), 1e2, window).c == pytest.approx(smallest_c, rel=1e-6)
    coefficients = noise_coefficients((0.5, 0.0), 2.5, 3)
    assert (coefficients.a, coefficients.b, coefficients.c) == pytest.approx((0.0797, 0.264, 8.27), rel=2e-3)


def test_the_noise_model_agrees_with_simulated_windows() -> None:
    """The scatter of 20 000 noisy windows agrees with the model within 3 %. The light in each pixel is integrated with
    scipy's normal distribution.
    """
    rng = np.random.default_rng(1)
    model = DarkModel(0.005, 4000.0, 0.01, 5300.0)
    offset, ratio, star_e, exposure = 0.4, 2.5, 43_400.0, 2.0
    edge = np.arange(4) - 1.5
    x, y = (np.diff(norm.cdf((edge - o) * ratio)) for o in (offset, 0.0))
    light = star_e * np.outer(y, x)
    shape = (20_000, 3, 3)
    dark = rng.poisson(4000.0 * exposure * (1 + 0.01 * rng.normal(size=shape)))
    frames = rng.poisson(light * (1 + 0.005 * rng.normal(size=shape))) + dark + np.sqrt(5300.0) * rng.normal(size=shape)
    located_px, _, _ = mean_locations_px(frames, 4000.0 * exposure)
    expected = model.position_sigma_px(noise_coefficients((offset, 0.0), ratio, 3), star_e, exposure)
    assert np.std(located_px) == pytest.approx(expected, rel=0.03)
    assert np.mean(located_px) - offset == pytest.approx(float(location_error_px(offset, ratio, 3)), abs=5e-4)


def test_the_mean_locator_uses_columns_as_x() -> None:
    """A spot to the right of and below the middle has positive offsets, and the dark mean is subtracted."""
    frame = spots(3, 3, np.array([[1.2, 1.1]]), np.array([1000.0]), 0.45) + 7.0
    x, y, light = mean_locations_px(frame[None], 7.0)
    assert x[0] == pytest.approx(0.2, abs=0.01)
    assert y[0] == pytest.approx(0.1, abs=0.01)
    assert light[0] == pytest.approx(1000.0, rel=0.02)


def test_the_dark_mean_ignores_stars() -> None:
    """Stars and hot pixels do not raise the dark mean, and its fraction of a digital number is preserved. A saturated
    frame gives the saturation level.
    """
    rng = np.random.default_rng(2)
    frame = np.rint(50.3 + rng.normal(size=(256, 256)))
    frame[10:20, 10:20] = 4000
    assert dark_mean_dn(frame, 1.0) == pytest.approx(50.3, abs=0.02)
    assert dark_mean_dn(np.full((8, 8), 4095), 1.0) == 4095


def test_the_coarse_mask_contains_faint_stars() -> None:
    """The coarse image preserves the sum of the pixels. A faint star at the corner of four blocks is inside the mask;
    an empty frame has an empty mask.
    """
    rng = np.random.default_rng(3)
    frame = 50 + rng.normal(size=(30, 33)) + spots(30, 33, np.array([[15.5, 7.5]]), np.array([170.0]), 0.45)
    assert coarse_image(frame, 4).sum() == pytest.approx(frame.sum())
    mask = coarse_mask(frame, 50.0, 1.0, 4, 5.0)
    assert mask[5:11, 13:19].all()
    assert mask.mean() < 0.5
    assert not coarse_mask(np.full((30, 33), 50), 50.0, 1.0, 4, 5.0).any()


def test_windows_are_clipped_at_the_frame() -> None:
    """Predicted windows are squares of pixels. Windows outside the frame, or at NaN, are dropped."""
    mask = windows_mask((10, 12), np.array([[5.0, 5.0], [0.0, 9.0], [-30.0, 4.0], [np.nan, 1.0]]), 1.0)
    assert mask[4:7, 4:7].all()
    assert mask.sum() == 9 + 4


def _rows_within(icrs: Array, centre: Array, radius: float) -> set[int]:
    """Return the rows of the stars within an angle of a direction."""
    return set(np.flatnonzero(icrs @ centre >= np.cos(radius)).tolist())


def test_the_walk_finds_the_stars_of_a_search_with_fewer_comparisons() -> None:
    """For fields 1° apart, the walk finds the same stars as a search of the whole list, with a twentieth of the
    comparisons (document: 120 of 3000).
    """
    icrs = load_stars(8.0).brighter_than(5.6).icrs[:3000]
    links = neighbour_links(icrs)
    rng = np.random.default_rng(4)
    comparisons = []
    for _ in range(100):
        centre = matrix_from_quaternion(random_quaternion(rng))[2]
        next_centre = rotation_from_vector(np.radians(1.0) * np.cross(centre, [0.6, 0.0, 0.8])) @ centre
        start_rows = np.flatnonzero(icrs @ centre >= np.cos(np.radians(5)))
        walked = walk(links, icrs, start_rows, next_centre, np.radians(7.0))
        assert set(walked.rows.tolist()) == _rows_within(icrs, next_centre, np.radians(7.0))
        comparisons.append(walked.checks if len(start_rows) else 0)
    assert 0 < np.mean(comparisons) < 150


def test_the_walk_finds_a_distant_field() -> None:
    """A field on the other side of the sky is found. Without a start star the whole list is searched."""
    icrs = load_stars(5.0).icrs
    links = neighbour_links(icrs)
    centre = np.array([0.0, 0.0, 1.0])
    start = np.array([np.argmin(icrs @ centre)])
    expected = _rows_within(icrs, centre, 0.1)
    assert set(walk(links, icrs, start, centre, 0.1).rows.tolist()) == expected
    assert walk(links, icrs, start[:0], centre, 0.1).checks == len(icrs) == linear_search(icrs, centre, 0.1).checks


def test_guidance_errors_need_unexpected_spots() -> None:
    """Fewer than two verified stars and at least one unexpected spot are a guidance error (Fig. 6.1 step 2f). An empty
    field is not.
    """
    assert [raises_guidance_error(v, u) for v, u in ((2, 5), (1, 1), (0, 0))] == [False, True, False]


def test_magnitudes_fit_within_their_error() -> None:
    """A difference of up to half a magnitude fits. Saturated spots may be brighter stars, and unknown magnitudes always
    fit.
    """
    spot, star = np.array([4.0, 4.0, 4.0, 4.0, 1.5, 1.5]), np.array([4.4, 4.6, 3.4, np.nan, 0.0, 3.0])
    saturated = np.array([False, False, False, False, True, True])
    assert magnitude_fits(spot, saturated, star, 0.5).tolist() == [True, False, False, True, True, False]


def _pairs(rng: np.random.Generator, attitude: Array, sigma: float, spread: float) -> tuple[Array, Array]:
    """Return noisy directions of six stars in the camera frame, and their directions in ICRS."""
    cam = np.column_stack([spread * rng.uniform(-1, 1, (6, 2)), np.ones(6)])
    cam /= np.linalg.norm(cam, axis=1, keepdims=True)
    icrs = cam @ attitude
    noisy = cam + sigma * rng.normal(size=cam.shape)
    return noisy / np.linalg.norm(noisy, axis=1, keepdims=True), icrs


def test_differential_corrections_converge_to_the_least_squares_attitude() -> None:
    """From an initial error of 3°, repeated corrections converge to the solution of scipy's align_vectors. A single
    correction leaves a second-order error.
    """
    rng = np.random.default_rng(5)
    for _ in range(10):
        truth = matrix_from_quaternion(random_quaternion(rng))
        cam, icrs = _pairs(rng, truth, 1e-5, 0.03)
        start = rotation_from_vector(np.radians([2.0, -2.0, 1.0])) @ truth
        converged = differential_attitude(cam, icrs, start)
        expected = Rotation.align_vectors(cam, icrs)[0].as_matrix()
        assert converged is not None
        assert rotation_angle_rad(converged, expected) < 1e-9
        one_step = differential_attitude(cam, icrs, start, steps=1)
        assert one_step is not None
        assert rotation_angle_rad(one_step, expected) > ARCSEC_RAD


def test_one_direction_does_not_determine_the_attitude() -> None:
    """A single star, or several stars in the same direction, give no attitude."""
    star = np.array([[0.0, 0.0, 1.0]])
    assert differential_attitude(star, star, np.eye(3)) is None
    assert differential_attitude(np.repeat(star, 3, 0), np.repeat(star, 3, 0), np.eye(3)) is None


def test_two_cameras_at_right_angles_determine_all_three_angles() -> None:
    """The roll of one camera is more than twenty times less accurate than its other angles. With a second camera all
    three angles are accurate, and the covariance agrees with the errors.
    """
    rng = np.random.default_rng(6)
    mount = [np.eye(3), rotation_from_vector(np.array([0.0, np.pi / 2, 0.0]))]
    errors: list[list[Array]] = [[], []]
    for _ in range(200):
        truth = matrix_from_quaternion(random_quaternion(rng))
        views = []
        for body_from_cam in mount:
            cam, icrs = _pairs(rng, body_from_cam.T @ truth, 2e-6, 0.03)
            views.append(CameraView(cam, icrs, np.full(6, 2e-6), body_from_cam))
        for k, used_views in enumerate((views[:1], views)):
            estimate = body_attitude(used_views)
            assert estimate is not None
            errors[k].append(rotation_vector_rad(matrix_from_quaternion(estimate.quaternion) @ truth.T))
            sigma = np.sqrt(np.diag(estimate.covariance_rad2))
    one_camera, two_cameras = (np.std(e, axis=0) for e in errors)
    assert one_camera[2] > 20 * one_camera[0]
    assert two_cameras.max() < 2 * one_camera[0]
    np.testing.assert_allclose(two_cameras, sigma, rtol=0.4)
    assert body_attitude([]) is None


def test_attitudes_are_extrapolated_and_averaged() -> None:
    """A constant rate is extrapolated exactly. A line fitted to nine noisy estimates is more accurate than one
    estimate.
    """
    rng = np.random.default_rng(7)
    start, step = matrix_from_quaternion(random_quaternion(rng)), rotation_from_vector(np.array([0.01, 0.02, -0.01]))
    last_two = [quaternion_from_matrix(r) for r in (step @ start, start)]
    assert rotation_angle_rad(extrapolate(*last_two), step @ step @ start) < 1e-12
    errors_rad = []
    for _ in range(200):
        noisy = [rotation_from_vector(1e-4 * rng.normal(size=3)) for _ in range(9)]
        rotating = [n @ np.linalg.matrix_power(step.T, k) @ start for k, n in enumerate(noisy)]
        errors_rad.append(
            rotation_angle_rad(_matrix(average_estimates([quaternion_from_matrix(r) for r in rotating])), start)
        )
    single = 1e-4 * np.sqrt(3)
    assert np.sqrt(np.mean(np.square(errors_rad))) == pytest.approx(single * np.sqrt(0.378), rel=0.1)


def _matrix(quaternion: Array) -> Array:
    return matrix_from_quaternion(quaternion)


def test_least_distances_pair_each_star_once() -> None:
    """The closest pair is assigned first, so a false star next to a star that is already assigned remains unpaired."""
    along = np.array([0.0, 0.01, 0.02])
    predicted = np.column_stack([along, np.zeros(3), np.ones(3)])
    measured = np.column_stack([along[[2, 0]] + [0.001, 0.0005], np.zeros(2), np.ones(2)])
    crowded = np.vstack([measured, [[0.001, 0, 1.0]]])
    i, j = pair_least_distance(crowded, predicted, 0.005)
    assert (i.tolist(), j.tolist()) == ([0, 1], [2, 0])
    assert len(pair_least_distance(crowded[:0], predicted, 0.005)[0]) == 0


def test_unreliable_identifications_are_rejected() -> None:
    """A close companion is not counted as a separate star, a straight pattern has no handedness, and errors that fill
    the tolerance are rejected.
    """
    pixel = 1e-4
    tangents = np.column_stack([[0.0, 0.02, 0.01, 0.02 + pixel], [0.0, 0.0, 0.015, 0.0], np.ones(4)])
    unit = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    attitude = matrix_from_quaternion(random_quaternion(np.random.default_rng(9)))
    assert separate_stars(unit, 5 * pixel) == 3
    for fast in (False, True):
        assert is_handed(unit, unit @ attitude, pixel, fast=fast)
        assert not is_handed(unit[[0, 1, 3]], unit[[0, 1, 3]] @ attitude, pixel, fast=fast)
    small, large = np.full(6, 0.1 * pixel), np.full(6, 0.9 * pixel)
    sigma = np.full(6, 0.1 * pixel)
    assert errors_objection(small, sigma, pixel, pixel) == ""
    assert "0.64 px rms, 0.33 allowed" in errors_objection(large, sigma, pixel, pixel)
    assert errors_objection(large, 4 * sigma, pixel, pixel) == ""

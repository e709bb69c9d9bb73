"""Accuracy of the reference chain's attitude: scatter compared with the covariance, and correction of aberration."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, chi2

from gss.catalogue_tools.corrections.ephemeris import bodies_at
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.aberration import aberrate
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import Centroids, SolveResult
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains import reference
from gss.pipeline.identify.near import BoundedPrior
from gss.pipeline.identify.verify import SkyCatalogue
from gss.pipeline.render import render

STARS = load_stars(8.0)
SKY = SkyCatalogue(STARS.hip, STARS.icrs, STARS.v_mag)
TRIALS = 400


def known_sky(profile: CameraProfile) -> reference.KnownSky:
    """Return the prepared sky as the solver makes it."""
    return reference.known_sky(SKY, profile.camera, profile.sensor.faint_limit_mag)


def attitude_error(result: SolveResult, attitude: Array) -> Array:
    """Return the (3,) small rotation from the true to the estimated camera frame, in the estimated frame."""
    assert result.attitude is not None
    error = result.attitude.cam_from_icrs @ attitude.T
    return np.array([error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]]) / 2


def random_list(
    profile: CameraProfile, stars: reference.KnownSky, rng: np.random.Generator, attitude: Array
) -> Centroids:
    """Return centroids of the stars with an error that differs from star to star and is stated with each."""
    projected = profile.camera.project(stars.sky.icrs @ attitude.T)
    inside = np.flatnonzero(
        profile.camera.contains(projected) & (stars.sky.icrs @ attitude[2] > np.cos(profile.camera.half_diagonal_rad))
    )
    sigma = rng.uniform(0.05, 0.5, len(inside))
    pixels = projected[inside] + rng.normal(size=(len(inside), 2)) * sigma[:, None]
    flux = 10 ** (-0.4 * (stars.sky.v_mag[inside] + rng.normal(0, 0.1, len(inside))))
    return replace(Centroids.from_pixels(pixels, flux), sigma_px=sigma)


def assert_scatter_agrees_with_covariance(normalised: Array, squares: Array) -> None:
    """Check that each axis has unit variance and no bias, and that the sum of squares is χ² with three degrees of
    freedom. Each check fails by chance in one of 10 000 cases.
    """
    n = len(squares)
    low, high = chi2.ppf([5e-5, 1 - 5e-5], n) / n
    for axis in range(3):
        assert low < np.mean(normalised[:, axis] ** 2) < high
        assert abs(np.mean(normalised[:, axis])) < 4 / np.sqrt(n)
    low, high = chi2.ppf([5e-5, 1 - 5e-5], 3 * n) / (3 * n)
    assert low < squares.mean() / 3 < high
    assert np.sum(squares > chi2.ppf(0.99, 3)) <= binom.ppf(1 - 1e-4, n, 0.01)


def test_scatter_from_lists_agrees_with_the_covariance(trials: Any) -> None:
    """For lists of stars with different errors, the normalised attitude errors are standard normal about each axis."""
    profile = shipped_camera("sunsat")
    stars, rng = known_sky(profile), np.random.default_rng(31)
    normalised: list[Array] = []
    squares: list[float] = []
    while len(squares) < trials(TRIALS):
        attitude = matrix_from_quaternion(random_quaternion(rng))
        result = reference.solve_centroids(
            random_list(profile, stars, rng, attitude), profile.camera, stars, hint=BoundedPrior(attitude, 0.01)
        )
        if result.attitude is None:
            continue
        error = attitude_error(result, attitude)
        normalised.append(error / np.sqrt(np.diag(result.attitude.covariance_rad2)))
        squares.append(float(error @ np.linalg.solve(result.attitude.covariance_rad2, error)))
    assert_scatter_agrees_with_covariance(np.array(normalised), np.array(squares))


def test_scatter_from_pixels_agrees_with_the_covariance(trials: Any) -> None:
    """The same holds for rendered frames, with the chain's own centroid errors."""
    profile = shipped_camera("cubestar")
    stars, rng = known_sky(profile), np.random.default_rng(32)
    rendered_stars = STARS.brighter_than(6.0)
    normalised: list[Array] = []
    squares: list[float] = []
    attitude = matrix_from_quaternion(random_quaternion(rng))
    while len(squares) < trials(TRIALS):
        if len(squares) % 8 == 0:
            attitude = matrix_from_quaternion(random_quaternion(rng))
        frame = render(rendered_stars, profile.camera, profile.sensor, attitude, profile.sensor.exposure_s, rng)
        hint = BoundedPrior(attitude, 0.01)
        result = reference.solve_known(frame.pixels, profile.camera, profile.sensor, stars, hint=hint)
        if result.attitude is None:
            attitude = matrix_from_quaternion(random_quaternion(rng))
            continue
        error = attitude_error(result, attitude)
        normalised.append(error / np.sqrt(np.diag(result.attitude.covariance_rad2)))
        squares.append(float(error @ np.linalg.solve(result.attitude.covariance_rad2, error)))
    assert_scatter_agrees_with_covariance(np.array(normalised), np.array(squares))


@pytest.mark.parametrize("name", ["cubestar", "sunsat"])
def test_aberration_is_corrected_within_the_noise(name: str) -> None:
    """For a moving observer without a stated velocity, the boresight is wrong by up to 20″ in a known direction. With
    the velocity, only noise remains.
    """
    profile = shipped_camera(name)
    stars, rng = known_sky(profile), np.random.default_rng(33)
    velocity_c = bodies_at(2026.4).earth_velocity_c
    rendered_stars = STARS.brighter_than(min(profile.sensor.faint_limit_mag + 2, 8.0))
    apparent = replace(rendered_stars, icrs=aberrate(rendered_stars.icrs, velocity_c))
    uncorrected, corrected, expected = [], [], []
    for _ in range(12):
        attitude = matrix_from_quaternion(random_quaternion(rng))
        frame = render(apparent, profile.camera, profile.sensor, attitude, profile.sensor.exposure_s, rng)
        without_velocity = reference.solve_known(frame.pixels, profile.camera, profile.sensor, stars)
        with_velocity = reference.solve_known(
            frame.pixels, profile.camera, profile.sensor, stars, velocity_c=velocity_c
        )
        if without_velocity.attitude is None or with_velocity.attitude is None:
            continue
        assert without_velocity.velocity_c is None
        assert with_velocity.velocity_c == pytest.approx(tuple(velocity_c))
        error = with_velocity.attitude.cam_from_icrs[2] - attitude[2]
        corrected.append(attitude @ error / with_velocity.attitude.sigma_rad[0])
        uncorrected.append(without_velocity.attitude.cam_from_icrs[2] - attitude[2])
        expected.append(attitude[2] - aberrate(attitude[2][None], velocity_c)[0])
    assert len(corrected) >= 9
    shift = np.linalg.norm(expected, axis=1)
    assert shift.max() > 10 * ARCSEC_RAD
    # Without the velocity, the error is the aberration itself, in direction and size.
    along = np.sum(np.array(uncorrected) * expected, axis=1).sum() / np.sum(shift**2)
    assert 0.7 < along < 1.3
    cross_boresight = np.array(corrected)[:, :2]
    assert np.sqrt(np.mean(cross_boresight**2)) < 1.6
    assert np.abs(cross_boresight.mean(0)).max() < 4 / np.sqrt(len(cross_boresight))

"""What the reference chain's attitude is worth: scatter against covariance, and the motion of the observer."""

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


def known_sky(known: CameraProfile) -> reference.KnownSky:
    """As the solver makes it."""
    return reference.known_sky(SKY, known.camera, known.sensor.faint_limit_mag)


def turned_by(result: SolveResult, pose: Array) -> Array:
    """(3,) small rotation from the true to the found camera frame, in the found one."""
    assert result.attitude is not None
    error = result.attitude.cam_from_icrs @ pose.T
    return np.array([error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]]) / 2


def lists(known: CameraProfile, stars: reference.KnownSky, rng: np.random.Generator, pose: Array) -> Centroids:
    """Centroids of the sky's stars with errors that differ from star to star and are stated with them."""
    seen = known.camera.project(stars.sky.icrs @ pose.T)
    inside = np.flatnonzero(
        known.camera.contains(seen) & (stars.sky.icrs @ pose[2] > np.cos(known.camera.half_diagonal_rad))
    )
    sigma = rng.uniform(0.05, 0.5, len(inside))
    pixels = seen[inside] + rng.normal(size=(len(inside), 2)) * sigma[:, None]
    flux = 10 ** (-0.4 * (stars.sky.v_mag[inside] + rng.normal(0, 0.1, len(inside))))
    return replace(Centroids.from_pixels(pixels, flux), sigma_px=sigma)


def assert_scatter_is_the_covariance(normalised: Array, squares: Array) -> None:
    """Each axis has its variance, no bias, and the three together are χ² of three, all within 1 in 10 000 of chance."""
    n = len(squares)
    low, high = chi2.ppf([5e-5, 1 - 5e-5], n) / n
    for axis in range(3):
        assert low < np.mean(normalised[:, axis] ** 2) < high
        assert abs(np.mean(normalised[:, axis])) < 4 / np.sqrt(n)
    low, high = chi2.ppf([5e-5, 1 - 5e-5], 3 * n) / (3 * n)
    assert low < squares.mean() / 3 < high
    assert np.sum(squares > chi2.ppf(0.99, 3)) <= binom.ppf(1 - 1e-4, n, 0.01)


def test_scatter_from_lists_is_the_covariance(trials: Any) -> None:
    """Lists whose stars have ten different errors: normalised attitude errors are standard normal about each axis."""
    known = shipped_camera("sunsat")
    stars, rng = known_sky(known), np.random.default_rng(31)
    normalised: list[Array] = []
    squares: list[float] = []
    while len(squares) < trials(TRIALS):
        pose = matrix_from_quaternion(random_quaternion(rng))
        result = reference.solve_centroids(
            lists(known, stars, rng, pose), known.camera, stars, hint=BoundedPrior(pose, 0.01)
        )
        if result.attitude is None:
            continue
        error = turned_by(result, pose)
        normalised.append(error / np.sqrt(np.diag(result.attitude.covariance_rad2)))
        squares.append(float(error @ np.linalg.solve(result.attitude.covariance_rad2, error)))
    assert_scatter_is_the_covariance(np.array(normalised), np.array(squares))


def test_scatter_from_pixels_is_the_covariance(trials: Any) -> None:
    """Rendered frames, the errors of the centroids being the chain's own: the same."""
    known = shipped_camera("cubestar")
    stars, rng = known_sky(known), np.random.default_rng(32)
    drawn = STARS.brighter_than(6.0)
    normalised: list[Array] = []
    squares: list[float] = []
    pose = matrix_from_quaternion(random_quaternion(rng))
    while len(squares) < trials(TRIALS):
        if len(squares) % 8 == 0:
            pose = matrix_from_quaternion(random_quaternion(rng))
        frame = render(drawn, known.camera, known.sensor, pose, known.sensor.exposure_s, rng)
        hint = BoundedPrior(pose, 0.01)
        result = reference.solve_known(frame.pixels, known.camera, known.sensor, stars, hint=hint)
        if result.attitude is None:
            pose = matrix_from_quaternion(random_quaternion(rng))
            continue
        error = turned_by(result, pose)
        normalised.append(error / np.sqrt(np.diag(result.attitude.covariance_rad2)))
        squares.append(float(error @ np.linalg.solve(result.attitude.covariance_rad2, error)))
    assert_scatter_is_the_covariance(np.array(normalised), np.array(squares))


@pytest.mark.parametrize("name", ["cubestar", "sunsat"])
def test_aberration_is_taken_out_to_the_noise(name: str) -> None:
    """Frames of a moving observer: without its velocity the boresight is off by up to 20″ in a known direction, with it
    nothing is left but noise."""
    known = shipped_camera(name)
    stars, rng = known_sky(known), np.random.default_rng(33)
    velocity_c = bodies_at(2026.4).earth_velocity_c
    drawn = STARS.brighter_than(min(known.sensor.faint_limit_mag + 2, 8.0))
    apparent = replace(drawn, icrs=aberrate(drawn.icrs, velocity_c))
    kept, taken, expected = [], [], []
    for _ in range(12):
        pose = matrix_from_quaternion(random_quaternion(rng))
        frame = render(apparent, known.camera, known.sensor, pose, known.sensor.exposure_s, rng)
        without = reference.solve_known(frame.pixels, known.camera, known.sensor, stars)
        with_it = reference.solve_known(frame.pixels, known.camera, known.sensor, stars, velocity_c=velocity_c)
        if without.attitude is None or with_it.attitude is None:
            continue
        assert without.velocity_c is None
        assert with_it.velocity_c == pytest.approx(tuple(velocity_c))
        off = with_it.attitude.cam_from_icrs[2] - pose[2]
        taken.append(pose @ off / with_it.attitude.sigma_rad[0])
        kept.append(without.attitude.cam_from_icrs[2] - pose[2])
        expected.append(pose[2] - aberrate(pose[2][None], velocity_c)[0])
    assert len(taken) >= 9
    shift = np.linalg.norm(expected, axis=1)
    assert shift.max() > 10 * ARCSEC_RAD
    # What stays in without the velocity is the shift itself, in direction and size.
    along = np.sum(np.array(kept) * expected, axis=1).sum() / np.sum(shift**2)
    assert 0.7 < along < 1.3
    z = np.array(taken)[:, :2]
    assert np.sqrt(np.mean(z**2)) < 1.6
    assert np.abs(z.mean(0)).max() < 4 / np.sqrt(len(z))

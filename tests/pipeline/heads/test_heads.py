"""Several heads on one body: fusion, differences and misalignment, tested with attitudes of known covariance and
injected errors.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import BadInput
from gss.domain.rotation import (
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_product,
    random_quaternion,
    rotation_from_vector,
    rotation_x,
    rotation_y,
    turn_between,
    turned,
)
from gss.pipeline.heads.fusion import boresight_of, difference, fuse, head_covariance, in_body
from gss.pipeline.heads.misalignment import JUMPED_AFTER, Misalignment, started, updated
from gss.pipeline.heads.pairing import MeasuredAttitude, attitude_at
from gss.pipeline.track.cameras_together import BodyAttitude

MOUNTINGS = [quaternion_from_matrix(m) for m in (np.eye(3), rotation_x(np.radians(85)), rotation_y(np.radians(70)))]
SIGMAS = [(5, 40), (7, 60), (4, 25)]


def covariance(head: int) -> np.ndarray:
    """Return the covariance of the camera attitude of a head."""
    cross, roll = SIGMAS[head]
    return head_covariance(cross * ARCSEC_RAD, roll * ARCSEC_RAD)


def measured(
    rng: np.random.Generator, body: np.ndarray, head: int, misalignment: np.ndarray | None = None
) -> BodyAttitude:
    """Return the attitude measured by a head, with noise of the stated covariance. The true mounting differs from the
    nominal one by ``misalignment``.
    """
    mounting = MOUNTINGS[head] if misalignment is None else turned(MOUNTINGS[head], misalignment)
    camera = quaternion_product(quaternion_inverse(mounting), body)
    noisy = turned(camera, rng.normal(size=3) * np.sqrt(np.diag(covariance(head))))
    return in_body(noisy, covariance(head), MOUNTINGS[head])


def error(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the rotation vector from the estimate to the truth."""
    return turn_between(estimate[None], truth[None])[0]


def test_fused_attitude_has_the_stated_covariance() -> None:
    """The squared normalised error of the fused attitude has the χ² distribution of three angles, and the agreement
    probability is uniform.
    """
    rng = np.random.default_rng(11)
    errors, agreements = [], []
    for _ in range(200):
        body = random_quaternion(rng)
        fused = fuse([measured(rng, body, head) for head in range(3)])
        error_rad = error(fused.quaternion, body)
        errors.append(error_rad @ np.linalg.solve(fused.covariance_rad2, error_rad))
        assert fused.agreement is not None
        agreements.append(fused.agreement.probability)
    assert kstest(errors, chi2(3).cdf).pvalue > 0.01
    assert kstest(agreements, "uniform").pvalue > 0.01


def test_each_head_measures_the_roll_of_the_other() -> None:
    """Two heads with boresights 85° apart measure all three angles to a few arcseconds, although each alone measures
    its roll only to 40″ or 60″.
    """
    fused = fuse([measured(np.random.default_rng(1), MOUNTINGS[0], head) for head in range(2)])
    assert np.sqrt(np.diag(fused.covariance_rad2)).max() < 8 * ARCSEC_RAD


def test_equal_isotropic_heads_give_the_mean_rotation() -> None:
    """With equal weights the result is scipy's mean of rotations."""
    rng = np.random.default_rng(2)
    base = random_quaternion(rng)
    quaternions = np.stack([turned(base, rng.normal(scale=1e-4, size=3)) for _ in range(4)])
    fused = fuse([BodyAttitude(q, np.eye(3) * 1e-10) for q in quaternions])
    assert np.linalg.norm(error(fused.quaternion, Rotation.from_quat(quaternions).mean().as_quat())) < 1e-11


def test_a_single_head_is_passed_through() -> None:
    """The attitude of a single head is returned unchanged and without a test of agreement. Without any head, an error
    is raised.
    """
    only = measured(np.random.default_rng(3), MOUNTINGS[1], 0)
    fused = fuse([only])
    assert fused.agreement is None
    assert np.allclose(fused.covariance_rad2, only.covariance_rad2)
    with pytest.raises(BadInput, match="no attitude"):
        fuse([])


def test_misalignment_appears_in_the_angle_between_boresights() -> None:
    """A misalignment of 60″ about the normal of both boresights changes the angle between them, within the stated
    sigma. Without it, the normalised change of the angle has unit variance.
    """
    rng = np.random.default_rng(4)
    axes = boresight_of(MOUNTINGS[0]), boresight_of(MOUNTINGS[1])
    normal = np.cross(*axes)
    normal /= np.linalg.norm(normal)
    body = random_quaternion(rng)
    misaligned = difference(measured(rng, body, 0), measured(rng, body, 1, 60 * ARCSEC_RAD * normal), *axes)
    assert misaligned.agreement.probability < 1e-6
    assert abs(misaligned.boresight_rad) == pytest.approx(60 * ARCSEC_RAD, abs=3 * misaligned.boresight_sigma_rad)
    assert misaligned.boresight_sigma_rad == pytest.approx(np.hypot(5, 7) * ARCSEC_RAD, rel=1e-6)
    aligned = [difference(measured(rng, body, 0), measured(rng, body, 1), *axes) for _ in range(300)]
    assert kstest([d.boresight_rad / d.boresight_sigma_rad for d in aligned], "norm").pvalue > 0.01


def test_attitude_is_interpolated_between_measurements() -> None:
    """The attitude of a rotating body is interpolated between two measurements. The error has the stated covariance,
    and an uncertain clock adds the rotation during that time. A single attitude is used only if a maximum rate is
    stated.
    """
    rng, rate = np.random.default_rng(5), np.array([2e-3, -1e-3, 5e-4])
    start = random_quaternion(rng)

    def body_at(time_s: float) -> np.ndarray:
        return turned(start, -rate * time_s)

    errors = []
    for _ in range(200):
        series = [MeasuredAttitude(t, 0.01, measured(rng, body_at(t), 0)) for t in (0.0, 1.0, 2.0)]
        interpolated = attitude_at(series, 1.3, 0.5, None)
        assert interpolated is not None
        error_rad = error(interpolated.attitude.quaternion, body_at(1.3))
        errors.append(error_rad @ np.linalg.solve(interpolated.attitude.covariance_rad2, error_rad))
    assert kstest(errors, chi2(3).cdf).pvalue > 0.01
    assert np.sqrt(np.trace(interpolated.timing_rad2)) == pytest.approx(0.01 * np.linalg.norm(rate), rel=0.2)
    assert attitude_at(series, 2.6, 0.5, None) is None
    assert attitude_at(series[:1], 0.1, 0.5, None) is None
    extrapolated = attitude_at(series[:1], 0.1, 0.5, np.radians(0.5))
    assert extrapolated is not None
    added_covariance = extrapolated.with_timing.covariance_rad2 - series[0].attitude.covariance_rad2
    assert np.sqrt(added_covariance[0, 0]) == pytest.approx(np.radians(0.5) * np.hypot(0.1, 0.01))


def filtered(rng: np.random.Generator, misalignment: np.ndarray, drift: np.ndarray, steps: int) -> Misalignment:
    """Run the misalignment filter on simulated pairs of attitudes, one every 10 s."""
    body = random_quaternion(rng)
    estimate = started(0.0, np.eye(3) * np.radians(0.5) ** 2)
    for k in range(steps):
        time_s = 10.0 * k
        pair = measured(rng, body, 0), measured(rng, body, 1, misalignment + drift * time_s)
        estimate = updated(estimate, time_s, *pair, np.zeros((3, 3)))
    return estimate


def test_misalignment_and_drift_are_recovered() -> None:
    """An injected misalignment of 60″ and drift of 36″ per hour are recovered within the stated sigma, which is small
    after half an hour. Over many runs, the squared normalised error of all six states agrees with the covariance.
    """
    rng = np.random.default_rng(6)
    misalignment, drift = np.array([60.0, 0, -20]) * ARCSEC_RAD, np.array([0, 36.0, 0]) * ARCSEC_RAD / 3600
    errors = []
    for _ in range(20):
        estimate = filtered(rng, misalignment, drift, 40)
        state_error = estimate.state - np.concatenate([misalignment + drift * estimate.time_s, drift])
        errors.append(state_error @ np.linalg.solve(estimate.covariance, state_error))
    assert kstest(errors, chi2(6).cdf).pvalue > 0.01
    long = filtered(rng, misalignment, drift, 180)
    assert np.all(np.abs(long.vector_rad - misalignment - drift * long.time_s) < 3 * long.sigma_rad)
    assert np.all(np.abs(long.drift_rad_s - drift) < 3 * long.drift_sigma_rad_s)
    assert long.drift_sigma_rad_s.max() * 3600 < 60 * ARCSEC_RAD
    assert long.samples == 180


def test_a_lasting_change_restarts_the_filter() -> None:
    """A single wrong difference is rejected. A lasting change of the mounting restarts the filter after a few
    differences and is counted. An older measurement is rejected.
    """
    rng = np.random.default_rng(7)
    body = random_quaternion(rng)
    estimate = filtered(rng, np.zeros(3), np.zeros(3), 30)
    jump = np.array([0.0, 900, 0]) * ARCSEC_RAD

    def step(estimate: Misalignment, at_s: float, misalignment: np.ndarray) -> Misalignment:
        pair = measured(rng, body, 0), measured(rng, body, 1, misalignment)
        return updated(estimate, at_s, *pair, np.zeros((3, 3)))

    after_one_outlier = step(estimate, 300.0, jump)
    assert (after_one_outlier.rejected, after_one_outlier.restarts) == (1, 0)
    assert step(after_one_outlier, 310.0, np.zeros(3)).rejected == 0
    for k in range(JUMPED_AFTER + 10):
        estimate = step(estimate, 300.0 + 10 * k, jump)
    assert estimate.restarts == 1
    assert np.all(np.abs(estimate.vector_rad - jump) < 4 * estimate.sigma_rad)
    with pytest.raises(BadInput, match="older"):
        step(estimate, 0.0, jump)


def test_a_large_mounting_error_is_found_despite_a_small_prior() -> None:
    """A mounting error much larger than the stated prior is found after a few differences and is not counted as a
    change.
    """
    rng, mounting_error = np.random.default_rng(8), np.radians([3.0, -2.0, 1.0])
    body, estimate = random_quaternion(rng), started(0.0, np.eye(3) * ARCSEC_RAD**2)
    for k in range(60):
        estimate = updated(
            estimate, float(k), measured(rng, body, 0), measured(rng, body, 1, mounting_error), np.zeros((3, 3))
        )
    assert estimate.restarts == 0
    assert np.linalg.norm(estimate.vector_rad - mounting_error) < 60 * ARCSEC_RAD
    true = rotation_from_vector(mounting_error)
    assert np.allclose(rotation_from_vector(estimate.vector_rad), true, atol=1e-3)

"""Several heads on one body, by injection: attitudes with known covariances, misalignment and drift."""

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
    cross, roll = SIGMAS[head]
    return head_covariance(cross * ARCSEC_RAD, roll * ARCSEC_RAD)


def measured(
    rng: np.random.Generator, body: np.ndarray, head: int, misalignment: np.ndarray | None = None
) -> BodyAttitude:
    """Attitude by a head, with noise of its covariance; its true mounting differs from the nominal one by the misalignment."""
    mounting = MOUNTINGS[head] if misalignment is None else turned(MOUNTINGS[head], misalignment)
    camera = quaternion_product(quaternion_inverse(mounting), body)
    noisy = turned(camera, rng.normal(size=3) * np.sqrt(np.diag(covariance(head))))
    return in_body(noisy, covariance(head), MOUNTINGS[head])


def error(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return turn_between(estimate[None], truth[None])[0]


def test_fused_attitude_is_as_uncertain_as_it_states() -> None:
    """The normalised error squared of the fused attitude has the χ² distribution of three angles, and so has the agreement."""
    rng = np.random.default_rng(11)
    errors, agreements = [], []
    for _ in range(200):
        body = random_quaternion(rng)
        fused = fuse([measured(rng, body, head) for head in range(3)])
        off = error(fused.quaternion, body)
        errors.append(off @ np.linalg.solve(fused.covariance_rad2, off))
        assert fused.agreement is not None
        agreements.append(fused.agreement.probability)
    assert kstest(errors, chi2(3).cdf).pvalue > 0.01
    assert kstest(agreements, "uniform").pvalue > 0.01


def test_roll_of_one_head_is_measured_by_the_other() -> None:
    """Two crossed heads know all three angles to a few arcseconds, although each knows its roll to 40″ and 60″."""
    fused = fuse([measured(np.random.default_rng(1), MOUNTINGS[0], head) for head in range(2)])
    assert np.sqrt(np.diag(fused.covariance_rad2)).max() < 8 * ARCSEC_RAD


def test_equal_isotropic_heads_give_the_mean_rotation() -> None:
    """With equal weights the result is scipy's mean of rotations."""
    rng = np.random.default_rng(2)
    base = random_quaternion(rng)
    several = np.stack([turned(base, rng.normal(scale=1e-4, size=3)) for _ in range(4)])
    fused = fuse([BodyAttitude(q, np.eye(3) * 1e-10) for q in several])
    assert np.linalg.norm(error(fused.quaternion, Rotation.from_quat(several).mean().as_quat())) < 1e-11


def test_one_head_agrees_with_nothing() -> None:
    """A single head is passed through, and there is no test of agreement; none at all is an error."""
    only = measured(np.random.default_rng(3), MOUNTINGS[1], 0)
    fused = fuse([only])
    assert fused.agreement is None
    assert np.allclose(fused.covariance_rad2, only.covariance_rad2)
    with pytest.raises(BadInput, match="no attitude"):
        fuse([])


def test_difference_of_two_heads() -> None:
    """A misalignment of 60″ across both boresights is seen in the angle between them, with the stated sigma; without it the
    normalised angle between the boresights has unit variance."""
    rng = np.random.default_rng(4)
    axes = boresight_of(MOUNTINGS[0]), boresight_of(MOUNTINGS[1])
    normal = np.cross(*axes)
    normal /= np.linalg.norm(normal)
    body = random_quaternion(rng)
    off = difference(measured(rng, body, 0), measured(rng, body, 1, 60 * ARCSEC_RAD * normal), *axes)
    assert off.agreement.probability < 1e-6
    assert abs(off.boresight_rad) == pytest.approx(60 * ARCSEC_RAD, abs=3 * off.boresight_sigma_rad)
    assert off.boresight_sigma_rad == pytest.approx(np.hypot(5, 7) * ARCSEC_RAD, rel=1e-6)
    plain = [difference(measured(rng, body, 0), measured(rng, body, 1), *axes) for _ in range(300)]
    assert kstest([d.boresight_rad / d.boresight_sigma_rad for d in plain], "norm").pvalue > 0.01


def test_attitude_between_measurements() -> None:
    """A turning body is interpolated between two attitudes; the error has the stated covariance, and an uncertain clock adds
    the turn in that time. A lone attitude is used only with a stated largest rate."""
    rng, rate = np.random.default_rng(5), np.array([2e-3, -1e-3, 5e-4])
    start = random_quaternion(rng)

    def at(time_s: float) -> np.ndarray:
        return turned(start, -rate * time_s)

    errors = []
    for _ in range(200):
        series = [MeasuredAttitude(t, 0.01, measured(rng, at(t), 0)) for t in (0.0, 1.0, 2.0)]
        found = attitude_at(series, 1.3, 0.5, None)
        assert found is not None
        off = error(found.attitude.quaternion, at(1.3))
        errors.append(off @ np.linalg.solve(found.attitude.covariance_rad2, off))
    assert kstest(errors, chi2(3).cdf).pvalue > 0.01
    assert np.sqrt(np.trace(found.timing_rad2)) == pytest.approx(0.01 * np.linalg.norm(rate), rel=0.2)
    assert attitude_at(series, 2.6, 0.5, None) is None
    assert attitude_at(series[:1], 0.1, 0.5, None) is None
    lone = attitude_at(series[:1], 0.1, 0.5, np.radians(0.5))
    assert lone is not None
    grown = lone.with_timing.covariance_rad2 - series[0].attitude.covariance_rad2
    assert np.sqrt(grown[0, 0]) == pytest.approx(np.radians(0.5) * np.hypot(0.1, 0.01))


def followed(rng: np.random.Generator, misalignment: np.ndarray, drift: np.ndarray, steps: int) -> Misalignment:
    body = random_quaternion(rng)
    estimate = started(0.0, np.eye(3) * np.radians(0.5) ** 2)
    for k in range(steps):
        now = 10.0 * k
        pair = measured(rng, body, 0), measured(rng, body, 1, misalignment + drift * now)
        estimate = updated(estimate, now, *pair, np.zeros((3, 3)))
    return estimate


def test_misalignment_and_drift_are_recovered() -> None:
    """60″ and 36″ an hour, injected, are recovered within the stated sigma, which half an hour makes small; over many runs the
    normalised error squared of all six states is that of the covariance."""
    rng = np.random.default_rng(6)
    misalignment, drift = np.array([60.0, 0, -20]) * ARCSEC_RAD, np.array([0, 36.0, 0]) * ARCSEC_RAD / 3600
    errors = []
    for _ in range(20):
        estimate = followed(rng, misalignment, drift, 40)
        off = estimate.state - np.concatenate([misalignment + drift * estimate.time_s, drift])
        errors.append(off @ np.linalg.solve(estimate.covariance, off))
    assert kstest(errors, chi2(6).cdf).pvalue > 0.01
    long = followed(rng, misalignment, drift, 180)
    assert np.all(np.abs(long.vector_rad - misalignment - drift * long.time_s) < 3 * long.sigma_rad)
    assert np.all(np.abs(long.drift_rad_s - drift) < 3 * long.drift_sigma_rad_s)
    assert long.drift_sigma_rad_s.max() * 3600 < 60 * ARCSEC_RAD
    assert long.samples == 180


def test_sudden_change_starts_the_filter_again() -> None:
    """One false difference is not used. A lasting change of the mounting is accepted after a few differences, and counted."""
    rng = np.random.default_rng(7)
    body = random_quaternion(rng)
    estimate = followed(rng, np.zeros(3), np.zeros(3), 30)
    jump = np.array([0.0, 900, 0]) * ARCSEC_RAD

    def step(estimate: Misalignment, at_s: float, misalignment: np.ndarray) -> Misalignment:
        pair = measured(rng, body, 0), measured(rng, body, 1, misalignment)
        return updated(estimate, at_s, *pair, np.zeros((3, 3)))

    once = step(estimate, 300.0, jump)
    assert (once.rejected, once.restarts) == (1, 0)
    assert step(once, 310.0, np.zeros(3)).rejected == 0
    for k in range(JUMPED_AFTER + 10):
        estimate = step(estimate, 300.0 + 10 * k, jump)
    assert estimate.restarts == 1
    assert np.all(np.abs(estimate.vector_rad - jump) < 4 * estimate.sigma_rad)
    with pytest.raises(BadInput, match="older"):
        step(estimate, 0.0, jump)


def test_a_large_error_of_the_mounting_needs_no_prior() -> None:
    """A mounting that is off by much more than stated is found after a few differences, without counting a change."""
    rng, off = np.random.default_rng(8), np.radians([3.0, -2.0, 1.0])
    body, estimate = random_quaternion(rng), started(0.0, np.eye(3) * ARCSEC_RAD**2)
    for k in range(60):
        estimate = updated(estimate, float(k), measured(rng, body, 0), measured(rng, body, 1, off), np.zeros((3, 3)))
    assert estimate.restarts == 0
    assert np.linalg.norm(estimate.vector_rad - off) < 60 * ARCSEC_RAD
    true = rotation_from_vector(off)
    assert np.allclose(rotation_from_vector(estimate.vector_rad), true, atol=1e-3)

"""Verdicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.domain.angles import Array
from gss.domain.results import Attitude, Centroids, Matches, Outcome, SolveResult, Truth, Verdict
from gss.domain.rotation import quaternion_from_matrix, rotation_from_vector
from gss.instruments.registry import shipped_camera
from gss.pipeline.score import assess, score

CAMERA = shipped_camera("cubestar").camera
PLACES = np.array([[100.0, 100], [900, 80], [500, 400], [300, 250]])
TRUTH = Truth(np.array([0, 0, 0, 1.0]), np.array([11, 12, 13, 14], np.int32), PLACES, np.array([1.0, 2, 3, 3]))
SIGMA_RAD = 1e-4


def _result(turn_rad: Array, hip: tuple[int, ...] = (11, 12, 13, 14), shift_px: float = 0.1) -> SolveResult:
    quaternion = quaternion_from_matrix(rotation_from_vector(np.asarray(turn_rad, float)))
    measured = PLACES[: len(hip)] + np.array([shift_px, 0.0])
    matches = Matches(
        np.arange(len(hip), dtype=np.int32), np.array(hip, np.int32), np.ones(len(hip)), np.zeros((len(hip), 2))
    )
    return SolveResult(
        "test",
        Outcome.SOLVED,
        "",
        CAMERA,
        (),
        Centroids.from_pixels(measured),
        matches,
        Attitude(quaternion, SIGMA_RAD**2 * np.diag([1, 1, 25.0])),
        0.0,
    )


@pytest.mark.parametrize(
    ("turn_rad", "verdict"),
    [
        ((0, 0, 0), Verdict.CORRECT),
        ((2.9e-4, 0, 0), Verdict.CORRECT),
        ((0, 0, 2.9e-4), Verdict.CORRECT),
        ((3.1e-4, 0, 0), Verdict.IMPRECISE),
        ((0, 6e-3, 0), Verdict.WRONG),
        ((0, 0, 3.0), Verdict.CORRECT),
    ],
)
def test_attitude_errors_are_graded_across_the_boresight(turn_rad: Array, verdict: Verdict) -> None:
    """Below 3σ correct, above imprecise, more than five pixels wrong; roll alone is not graded."""
    assert score(_result(turn_rad), TRUTH, CAMERA) is verdict


def test_expected_sigma_can_be_the_callers() -> None:
    """A chain without covariance is graded by an expected sigma."""
    assert score(_result((5e-4, 0, 0)), TRUTH, CAMERA, expected_sigma_rad=2e-4) is Verdict.CORRECT


def test_one_false_match_is_wrong() -> None:
    """A name on another star's place is wrong, however good the attitude; a name left out of the attitude is not."""
    bad = _result((0, 0, 0), (11, 12, 14, 13))
    graded = assess(bad, TRUTH, CAMERA)
    assert (graded.verdict, graded.matched, graded.false_matches) == (Verdict.WRONG, 2, 2)
    assert bad.matches is not None
    unused = replace(bad, matches=replace(bad.matches, weight=np.array([1.0, 1, 0, 0])))
    assert score(unused, TRUTH, CAMERA) is Verdict.CORRECT


def test_a_star_that_is_not_in_the_frame_is_a_false_match() -> None:
    """A name that truth does not have, on a centroid in the middle of the frame, is wrong."""
    assert score(_result((0, 0, 0), (11, 12, 99)), TRUTH, CAMERA) is Verdict.WRONG


def test_a_star_just_outside_may_be_matched_by_its_rim() -> None:
    """A star whose place lies beyond the edge is not in truth; matched to the light it leaves inside, it is right."""
    result = _result((0, 0, 0), (11, 12, 99))
    assert result.matches is not None
    pixels = result.centroids.pixels
    pixels[2] = [500.0, -0.2]
    residual = np.array([[0.0, 0], [0, 0], [0, 0.6]])
    rim = replace(
        result, centroids=Centroids.from_pixels(pixels), matches=replace(result.matches, residual_px=residual)
    )
    assert score(rim, TRUTH, CAMERA) is Verdict.CORRECT


def test_no_attitude_is_none() -> None:
    """No attitude counts as none, not as wrong."""
    silent = replace(_result((0, 0, 0)), outcome=Outcome.NONE, attitude=None, matches=None)
    graded = assess(silent, TRUTH, CAMERA)
    assert graded.verdict is Verdict.NONE
    assert np.isnan(graded.cross_rad)

"""Verdicts on solutions, by attitude error and by false matches."""

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
TRUE_PX = np.array([[100.0, 100], [900, 80], [500, 400], [300, 250]])
TRUTH = Truth(np.array([0, 0, 0, 1.0]), np.array([11, 12, 13, 14], np.int32), TRUE_PX, np.array([1.0, 2, 3, 3]))
SIGMA_RAD = 1e-4


def _result(rotation_rad: Array, hip: tuple[int, ...] = (11, 12, 13, 14), shift_px: float = 0.1) -> SolveResult:
    """Return a result with an attitude wrong by a rotation vector and matches shifted along the rows."""
    quaternion = quaternion_from_matrix(rotation_from_vector(np.asarray(rotation_rad, float)))
    measured = TRUE_PX[: len(hip)] + np.array([shift_px, 0.0])
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
    ("rotation_rad", "verdict"),
    [
        ((0, 0, 0), Verdict.CORRECT),
        ((2.9e-4, 0, 0), Verdict.CORRECT),
        ((0, 0, 2.9e-4), Verdict.CORRECT),
        ((3.1e-4, 0, 0), Verdict.IMPRECISE),
        ((0, 6e-3, 0), Verdict.WRONG),
        ((0, 0, 3.0), Verdict.CORRECT),
    ],
)
def test_attitude_errors_are_graded_across_the_boresight(rotation_rad: Array, verdict: Verdict) -> None:
    """An error across the boresight below 3σ is correct, above it imprecise, and above five pixels wrong. Roll errors
    have no effect.
    """
    assert score(_result(rotation_rad), TRUTH, CAMERA) is verdict


def test_the_caller_can_state_the_expected_sigma() -> None:
    """With an expected sigma from the caller, errors are graded by it instead of by the covariance."""
    assert score(_result((5e-4, 0, 0)), TRUTH, CAMERA, expected_sigma_rad=2e-4) is Verdict.CORRECT


def test_one_false_match_is_wrong() -> None:
    """A match with another star's position is wrong, however accurate the attitude. A match with weight zero has no
    effect.
    """
    swapped = _result((0, 0, 0), (11, 12, 14, 13))
    assessment = assess(swapped, TRUTH, CAMERA)
    assert (assessment.verdict, assessment.matched, assessment.false_matches) == (Verdict.WRONG, 2, 2)
    assert swapped.matches is not None
    unused = replace(swapped, matches=replace(swapped.matches, weight=np.array([1.0, 1, 0, 0])))
    assert score(unused, TRUTH, CAMERA) is Verdict.CORRECT


def test_a_star_that_is_not_in_the_frame_is_a_false_match() -> None:
    """A match with a star that is not in the truth, in the middle of the frame, is wrong."""
    assert score(_result((0, 0, 0), (11, 12, 99)), TRUTH, CAMERA) is Verdict.WRONG


@pytest.mark.parametrize(("predicted_row_px", "verdict"), [(-0.8, "correct"), (-0.3, "correct"), (1.0, "wrong")])
def test_a_star_just_outside_the_frame_may_be_matched(predicted_row_px: float, verdict: str) -> None:
    """A star just outside the frame is not in the truth. A match with the part of its light inside the frame is correct,
    also if a fitted lens predicts the star slightly inside.
    """
    result = _result((0, 0, 0), (11, 12, 99))
    assert result.matches is not None
    pixels = result.centroids.pixels
    pixels[2] = [500.0, -0.2]
    residual = np.array([[0.0, 0], [0, 0], [0, -0.2 - predicted_row_px]])
    at_edge = replace(
        result, centroids=Centroids.from_pixels(pixels), matches=replace(result.matches, residual_px=residual)
    )
    assert score(at_edge, TRUTH, CAMERA).value == verdict


def test_a_result_without_attitude_is_none() -> None:
    """A result without attitude counts as none, not as wrong."""
    without_attitude = replace(_result((0, 0, 0)), outcome=Outcome.NONE, attitude=None, matches=None)
    assessment = assess(without_attitude, TRUTH, CAMERA)
    assert assessment.verdict is Verdict.NONE
    assert np.isnan(assessment.cross_rad)

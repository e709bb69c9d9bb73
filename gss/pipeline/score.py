"""Compare a result with the truth: correct, imprecise, wrong or none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.frames import pointing_difference_rad
from gss.domain.results import SolveResult, Truth, Verdict
from gss.domain.rotation import matrix_from_quaternion

SIGMAS = 3.0
MATCH_PX = 3.0
ATTITUDE_PX = 5.0
EDGE_PX = 0.5


@dataclass(frozen=True)
class Score:
    """Result of a comparison: verdict, attitude errors (NaN without attitude; ``about_rad`` signed, right-handed about
    the boresight), and the numbers of true (``matched``) and false matches used for the attitude."""

    verdict: Verdict
    cross_rad: float
    about_rad: float
    matched: int
    false_matches: int


def assess(
    result: SolveResult,
    truth: Truth,
    camera: Camera,
    *,
    expected_sigma_rad: float | None = None,
    match_px: float = MATCH_PX,
    attitude_px: float = ATTITUDE_PX,
) -> Score:
    """Return the verdict with its attitude errors and match counts.

    CORRECT: all matches are true and the cross-boresight error is below 3σ, from the result's covariance unless
    ``expected_sigma_rad`` (per axis) is given. WRONG: the true position of a used match's star is more than
    ``match_px`` from its centroid (or not in the frame), or the boresight is more than ``attitude_px`` pixels off.
    IMPRECISE: neither CORRECT nor WRONG. A match with a close companion of the true star is a true match, because the
    positions agree.
    """
    if result.attitude is None:
        return Score(Verdict.NONE, float("nan"), float("nan"), 0, 0)
    cross_rad, about_rad = pointing_difference_rad(
        result.attitude.cam_from_icrs, matrix_from_quaternion(truth.quaternion)
    )
    matched, false = _count_matches(result, truth, match_px)
    sigma_rad = result.attitude.sigma_rad[0] if expected_sigma_rad is None else expected_sigma_rad
    if false or not cross_rad <= attitude_px * camera.pixel_rad:
        verdict = Verdict.WRONG
    else:
        verdict = Verdict.CORRECT if cross_rad < SIGMAS * sigma_rad else Verdict.IMPRECISE
    return Score(verdict, cross_rad, about_rad, matched, false)


def score(result: SolveResult, truth: Truth, camera: Camera, *, expected_sigma_rad: float | None = None) -> Verdict:
    """Return the verdict of :func:`assess`."""
    return assess(result, truth, camera, expected_sigma_rad=expected_sigma_rad).verdict


def _count_matches(result: SolveResult, truth: Truth, match_px: float) -> tuple[int, int]:
    """Return the numbers of true and false matches that were used for the attitude."""
    if result.matches is None or result.attitude is None:
        return 0, 0
    used = result.matches.weight > 0
    measured = result.centroids.pixels[result.matches.centroid[used]]
    true_px = true_pixels(truth, result.matches.hip[used])
    absent = np.isnan(true_px[:, 0])
    if absent.any():
        predicted = (measured - result.matches.residual_px[used])[absent]
        true_px[absent] = _pixels_outside(result, predicted, truth)
    off_px = np.hypot(measured[:, 0] - true_px[:, 0], measured[:, 1] - true_px[:, 1])
    right = int(np.count_nonzero(off_px <= match_px))
    return right, int(np.count_nonzero(used)) - right


def true_pixels(truth: Truth, hip: NDArray[np.int32]) -> Array:
    """Return the (n, 2) true pixels of these stars, NaN for a star that is not in the frame."""
    order = np.argsort(truth.hip)
    place = np.searchsorted(truth.hip, hip, sorter=order)
    index = np.append(order, -1)[place]
    true_px = np.vstack([truth.pixels.reshape(-1, 2), [np.nan, np.nan]])[index]
    true_px[np.append(truth.hip, -1)[index] != hip] = np.nan
    return np.asarray(true_px)


def _pixels_outside(result: SolveResult, predicted: Array, truth: Truth) -> Array:
    """Return the (n, 2) positions of the matched stars under the true attitude, NaN if more than ``EDGE_PX`` inside the
    detector.

    The truth does not list a star just outside the detector, although part of its light reaches the detector. Its
    position is computed from the position ``predicted`` (n, 2) by the result, rotated by the difference of the
    attitudes. With a fitted lens, it can be inside by a fraction of a pixel.
    """
    if result.attitude is None:
        return np.full_like(predicted, np.nan)
    true_from_result = matrix_from_quaternion(truth.quaternion) @ result.attitude.cam_from_icrs.T
    true_px = result.camera.project(result.camera.unproject(predicted) @ true_from_result.T)
    return np.where(result.camera.contains(true_px, EDGE_PX)[:, None], np.nan, true_px)

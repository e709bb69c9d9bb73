"""Comparison of a result with the true attitude that a simulator reported."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import SolveResult, Truth, Verdict
from gss.domain.rotation import matrix_from_quaternion
from gss.domain.stars import StarTable
from gss.pipeline.score import score


def judge(result: SolveResult, truth_quaternion: Array, profile: CameraProfile, stars: StarTable) -> Verdict:
    """Return the verdict on a result: correct, imprecise, wrong or none. Only the matched stars are computed, because the
    verdict depends on no other star."""
    rows = stars.rows_of(np.empty(0, np.int32) if result.matches is None else result.matches.hip)
    matched = stars.take(rows[rows >= 0])
    return score(result, truth_on(profile.camera, truth_quaternion, matched), profile.camera)


def truth_on(camera: Camera, quaternion: Array, stars: StarTable) -> Truth:
    """Return the truth for an attitude: the stars on the detector with their positions."""
    cam_from_icrs = matrix_from_quaternion(quaternion)
    near = np.flatnonzero(stars.icrs @ cam_from_icrs[2] > np.cos(camera.half_diagonal_rad * 1.05 + 0.01))
    pixels = camera.project(stars.icrs[near] @ cam_from_icrs.T)
    on = camera.contains(pixels)
    return Truth(quaternion, stars.hip[near][on], pixels[on], stars.v_mag[near][on])

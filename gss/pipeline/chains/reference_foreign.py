"""Reference chain for uncalibrated cameras: attitude, focal length and lens from the frame itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.failure_cause import CUT_TRAILS, MIRRORED
from gss.domain.results import Centroids, SolveResult
from gss.pipeline.chains.reference import NAME
from gss.pipeline.chains.reference_frame import MeasuredFrame, turning_of
from gss.pipeline.detect import find_stars
from gss.pipeline.identify.blind import BlindResult, identify_blind
from gss.pipeline.identify.blind_proof import with_aberration
from gss.pipeline.identify.faint import Spots
from gss.pipeline.identify.patterns import PatternLevel
from gss.pipeline.identify.verify import SkyCatalogue
from gss.pipeline.trace import Clock, Trace


def solve_foreign(
    pixels: NDArray[Any],
    fov_range_rad: tuple[float, float],
    sky: SkyCatalogue,
    level: Callable[[float], PatternLevel],
    *,
    velocity_c: Array | None = None,
    exposure_s: float | None = None,
    fast: bool | None = None,
    clock: Clock | None = None,
) -> SolveResult:
    """Solve a frame of an uncalibrated camera whose horizontal field of view lies in a range.

    The ``camera`` of the result has the fitted focal lengths, centre and distortion.
    """
    trace = Trace(clock)
    with trace.stage("detect"):
        detections = find_stars(pixels, fast=fast)
    centroids = detections.centroids
    shape = (int(pixels.shape[1]), int(pixels.shape[0]))
    guess = Camera.from_fov(*shape, float(np.sqrt(fov_range_rad[0] * fov_range_rad[1])))
    frame = MeasuredFrame(NAME, guess, centroids, detections, detections.notes, None, trace)
    if detections.cut_trails:
        return frame.unsolved(CUT_TRAILS)
    with trace.stage("identify"):
        result = _blind(centroids, detections.psf_sigma_px, shape, fov_range_rad, sky, level)
    if detections.streak_px:
        trailed = f"stars are trailed by about {detections.streak_px:.0f} px; positions are the middles of the trails"
        frame = replace(frame, notes=(*frame.notes, trailed))
    solution = result.solved
    if solution is None:
        with trace.stage("why not"):
            reverse = (
                _blind(
                    centroids.mirrored(shape[0]), detections.psf_sigma_px, shape, fov_range_rad, sky, level, odd=False
                )
                if len(centroids) >= 5
                else None
            )
        is_mirrored = reverse is not None and reverse.placed and not result.placed
        return frame.unsolved(MIRRORED if is_mirrored else result.reason)
    fit = with_aberration(solution, centroids.pixels, sky, velocity_c)
    if detections.trailed and exposure_s:
        with trace.stage("trails"):
            frame = replace(frame, turning=turning_of(pixels, detections, fit.camera, exposure_s, None, fast))
    rows, hip, probability = solution.rows, sky.hip[solution.stars], solution.false_match_probability
    return frame.solved(fit, rows, hip, probability, velocity_c)


def _blind(
    centroids: Centroids,
    psf_sigma_px: float,
    shape: tuple[int, int],
    fov_range_rad: tuple[float, float],
    sky: SkyCatalogue,
    level: Callable[[float], PatternLevel],
    odd: bool = True,
) -> BlindResult:
    magnitude = -2.5 * np.log10(np.maximum(centroids.flux_dn, 1e-12))
    spots = Spots(centroids.pixels, centroids.sigma_px, magnitude, psf_sigma_px)
    return identify_blind(spots, shape, fov_range_rad, sky, level, odd=odd)

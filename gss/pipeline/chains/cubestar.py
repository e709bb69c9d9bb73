"""The chain of CubeStar (Erlank 2013 ch. 4–5): plane search, 5x5 centroids, geometric voting, QUEST.

The same functions run in the simulator's firmware and on the ground, and :func:`solve` combines exactly the steps that
the device offers as commands. The result does not depend on time: equal frame, bank and parameters give bit-identical
results. ``cubestar_parameters.SOURCES`` documents, for each parameter, the choices that the document leaves open and
the tests added against false attitudes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera, Pinhole
from gss.domain.errors import BadInput
from gss.domain.results import Attitude, Centroids, Outcome, SolveResult
from gss.domain.rotation import matrix_from_quaternion
from gss.pipeline.attitude import quest, weighted_covariance_rad2
from gss.pipeline.centroid import brightest_first, window_centroids
from gss.pipeline.chains import proof
from gss.pipeline.chains.cubestar_match import CubestarMatching, match_stars
from gss.pipeline.chains.cubestar_parameters import (
    HINT_ERROR_RAD,
    NAME,
    CubestarParameters,
    default_parameters,
)
from gss.pipeline.chains.modes import AttitudePrior, Mode, next_mode
from gss.pipeline.chains.onboard import Detection, OnboardSolution
from gss.pipeline.identify.accidental import accidental_bound, chance_within, tracking_hypotheses
from gss.pipeline.kernels import kernels
from gss.pipeline.regions import Pixels, SearchLimits, grid_median_dn, region_records, search
from gss.pipeline.trace import Trace
from gss.skytables.bank import OnboardCatalogue

__all__ = [
    "NAME",
    "AttitudePrior",
    "CubestarMatching",
    "CubestarParameters",
    "Detection",
    "Mode",
    "OnboardSolution",
    "calculate_attitude",
    "default_parameters",
    "find_centroids",
    "hint_error_rad",
    "match_stars",
    "next_mode",
    "solve",
    "solve_centroids",
]


def find_centroids(pixels: Pixels, parameters: CubestarParameters, *, fast: bool | None = None) -> Detection:
    """Find the stars in a (rows, columns) frame (Erlank 2013 §4.1, §5.3.3).

    The chip subtracts the mean of its masked rows, so its black level is zero (§3.4.4). Frames of other cameras do not
    have this correction. Therefore the median of the search grid is used as the black level for the threshold and the
    centroid weights.

    ``fast``: see :func:`gss.pipeline.kernels.kernels`; the result is bit-identical.
    """
    p = parameters
    black_dn = grid_median_dn(pixels, p.search_step_px)
    limits = SearchLimits(p.min_area_px, p.max_area_px, p.max_invalid, p.max_centroids, p.edge_rule)
    regions = search(pixels, black_dn + p.threshold_dn, limits, p.search_step_px, kernels(fast))
    stars = regions.blobs.take(regions.accepted)
    centroids = window_centroids(pixels, stars, black_dn, p.threshold_dn, p.window_px, p.noise)
    return Detection(
        region_records(pixels, regions, black_dn, p.max_small_regions),
        centroids.take(brightest_first(centroids)),
        regions.invalid,
        black_dn,
        (regions.stopped,) if regions.stopped else (),
    )


def calculate_attitude(
    matching: CubestarMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    hint: AttitudePrior | None = None,
) -> OnboardSolution:
    """Compute the attitude by QUEST over the selected stars, weighted by their verification votes (Erlank 2013 §4.4, §5.3.4), and
    reject false attitudes by residuals, hint, false-match bound, handedness and focal length."""
    chosen = matching.selected
    if matching.reason:
        return proof.rejected(matching.reason)
    rows, unit = matching.row[chosen], matching.unit_cam[chosen]
    weights = matching.verification_votes[chosen].astype(float)
    reference = catalogue.icrs[rows].astype(float)
    reference /= np.linalg.norm(reference, axis=1, keepdims=True)
    quaternion = quest(unit, reference, weights)
    cam_from_icrs = matrix_from_quaternion(quaternion)
    miss_rad = np.linalg.norm(reference @ cam_from_icrs.T - unit, axis=1)
    misfit = proof.misfit(miss_rad, parameters.tolerance_rad, camera.pixel_rad)
    if misfit:
        return proof.rejected(misfit)
    probability = false_match_probability(matching, cam_from_icrs, camera, catalogue, parameters)
    reason = (
        _off_hint(matching.mode, hint, cam_from_icrs, camera, parameters)
        or proof.accidental(len(chosen), len(matching.row), probability, parameters.max_false_probability)
        or (
            _unsound(matching, centroids, camera, catalogue, parameters, cam_from_icrs, probability)
            if parameters.proves
            else ""
        )
    )
    if reason:
        return proof.rejected(reason, probability)
    sigma_rad = centroids.sigma_px[chosen] * camera.pixel_rad
    covariance = weighted_covariance_rad2(unit, weights, sigma_rad)
    seen_px = camera.project(reference @ cam_from_icrs.T)
    attitude = Attitude(quaternion, covariance)
    return proof.solved(attitude, probability, centroids, chosen, catalogue.hip[rows], weights, seen_px)


def _unsound(
    matching: CubestarMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    cam_from_icrs: Array,
    probability: float,
) -> str:
    """Return why the frame could be mirrored, have another focal length or contain a false match, or ""."""
    chosen, bank = matching.selected, catalogue.icrs.astype(float)
    reference = bank[matching.row[chosen]]
    # Without distortion, so that the positions agree with the directions from which the attitude was computed.
    ideal = replace(camera, distortion=Pinhole())
    residual_px = ideal.project(matching.unit_cam[chosen]) - ideal.project(reference @ cam_from_icrs.T)
    radius_px = parameters.tolerance_rad / camera.pixel_rad
    return (
        proof.mirrored(matching.unit_cam[chosen], reference, parameters.tolerance_rad)
        or proof.displaced(matching.unit_cam[chosen], centroids.sigma_px[chosen], reference, camera, cam_from_icrs)
        or proof.scattered(residual_px, centroids.sigma_px[chosen], probability)
        or proof.another_focal_length(centroids.pixels, matching.unit_cam, chosen, reference, bank, camera, radius_px)
        or proof.few_identified(len(chosen), len(matching.row), probability, bank, cam_from_icrs, camera)
    )


def hint_error_rad(camera: Camera, parameters: CubestarParameters) -> float:
    """Return the maximum angle between boresight and hint."""
    return proof.hint_error_rad(camera, parameters.assisted_radius_rad, HINT_ERROR_RAD)


def _off_hint(
    mode: Mode, hint: AttitudePrior | None, cam_from_icrs: Array, camera: Camera, parameters: CubestarParameters
) -> str:
    if mode is not Mode.ASSISTED or hint is None:
        return ""
    return proof.off_hint(hint, cam_from_icrs, hint_error_rad(camera, parameters))


def false_match_probability(
    matching: CubestarMatching,
    cam_from_icrs: Array,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
) -> float:
    """Return a bound on the expected number of accidental identifications with as many stars as this one.

    Every matching table entry gives two hypotheses for a pair of centroids. A hint reduces their number to the share of
    boresights that it allows. In tracking, the hypotheses are the pairs near predicted stars.
    """
    n, k = len(matching.row), len(matching.selected)
    per_sr = proof.stars_per_sr(catalogue.icrs.astype(float), cam_from_icrs, camera)
    if matching.mode is Mode.TRACKING:
        hypotheses = tracking_hypotheses(n, per_sr, parameters.tolerance_rad, parameters.tracking_radius_rad)
    else:
        hypotheses = 2.0 * matching.hits
        if matching.mode is Mode.ASSISTED:
            hypotheses *= (1 - np.cos(hint_error_rad(camera, parameters))) / (
                1 - np.cos(parameters.assisted_radius_rad)
            )
    return accidental_bound(hypotheses, k, n, chance_within(per_sr, parameters.tolerance_rad))


def solve(
    pixels: Pixels,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    *,
    mode: Mode = Mode.LOST_IN_SPACE,
    hint: AttitudePrior | None = None,
    clock: Callable[[], float] | None = None,
    trace: Trace | None = None,
    fast: bool | None = None,
) -> SolveResult:
    """Process one frame from pixels to attitude: find_centroids, match_stars, calculate_attitude."""
    if pixels.shape != (camera.rows, camera.columns):
        raise BadInput(
            "frame does not fit the camera",
            expected=f"{camera.rows} rows x {camera.columns} columns",
            got=" x ".join(map(str, pixels.shape)),
        )
    stages = trace if trace is not None else Trace(clock)
    with stages.stage("detect"):
        detection = find_centroids(pixels, parameters, fast=fast)
    stages.keep("detection", detection)
    result = solve_centroids(
        detection.centroids, camera, catalogue, parameters, mode=mode, hint=hint, clock=clock, trace=stages
    )
    return replace(result, regions=detection.regions, notes=detection.notes + result.notes)


def solve_centroids(
    centroids: Centroids,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    *,
    mode: Mode = Mode.LOST_IN_SPACE,
    hint: AttitudePrior | None = None,
    clock: Callable[[], float] | None = None,
    trace: Trace | None = None,
) -> SolveResult:
    """Process centroids, brightest first, as :func:`solve` does for a frame. The result has no regions."""
    stages = trace if trace is not None else Trace(clock)
    with stages.stage("match"):
        matching = match_stars(centroids, camera, catalogue, parameters, mode, hint)
    stages.keep("matching", matching)
    with stages.stage("attitude"):
        solution = calculate_attitude(matching, centroids, camera, catalogue, parameters, hint)
    over = len(centroids) - parameters.max_centroids
    return SolveResult(
        NAME,
        Outcome.SOLVED if solution.attitude is not None else Outcome.NONE,
        solution.reason,
        camera,
        (),
        centroids,
        solution.matches,
        solution.attitude,
        solution.false_match_probability,
        dict(stages.timing_s),
        (f"{over} faintest centroids not used: at most {parameters.max_centroids}",) if over > 0 else (),
    )

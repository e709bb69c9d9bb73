"""The chain of CubeStar (Erlank 2013 ch. 4–5): plane search, 5x5 centroids, geometric voting, QUEST.

The same functions run in the simulator's firmware and on the ground, and :func:`solve` combines exactly the steps
that the device offers as commands. Nothing depends on time; the same frame, bank and parameters give bit-identical results.
``cubestar_parameters.SOURCES`` documents, for each parameter, what the document leaves open and the tests added against
false attitudes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.results import Attitude, Centroids, Matches, Outcome, SolveResult
from gss.domain.rotation import matrix_from_quaternion
from gss.domain.stars import OnboardCatalogue
from gss.pipeline.attitude import quest, weighted_covariance_rad2
from gss.pipeline.centroid import brightest_first, window_centroids
from gss.pipeline.chains.cubestar_match import Matching, match_stars
from gss.pipeline.chains.cubestar_parameters import (
    HINT_ERROR_RAD,
    NAME,
    CubestarParameters,
    default_parameters,
)
from gss.pipeline.chains.modes import Hint, Mode, next_mode
from gss.pipeline.chains.onboard import Detection, Solution
from gss.pipeline.identify.accidental import accidental_bound, chance_within, tracking_hypotheses
from gss.pipeline.identify.focal_census import focal_objection
from gss.pipeline.identify.soundness import is_handed
from gss.pipeline.kernels import kernels
from gss.pipeline.regions import Pixels, SearchLimits, grid_median_dn, region_records, search
from gss.pipeline.trace import Trace

__all__ = [
    "NAME",
    "CubestarParameters",
    "Detection",
    "Hint",
    "Matching",
    "Mode",
    "Solution",
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

    The chip subtracts the mean of its masked rows, so that black is zero (§3.4.4). Frames of other cameras lack this
    correction, so the median of the search grid is used as black level, both for the threshold and for the centroid weights.

    ``fast``: see :func:`gss.pipeline.kernels.kernels`; the result is bit-identical.
    """
    p = parameters
    black_dn = grid_median_dn(pixels, p.search_step_px)
    limits = SearchLimits(p.min_area_px, p.max_area_px, p.max_invalid, p.max_centroids, p.edge_rule)
    found = search(pixels, black_dn + p.threshold_dn, limits, p.search_step_px, kernels(fast))
    stars = found.blobs.take(found.accepted)
    centroids = window_centroids(pixels, stars, black_dn, p.threshold_dn, p.window_px, p.noise)
    return Detection(
        region_records(pixels, found, black_dn, p.max_small_regions),
        centroids.take(brightest_first(centroids)),
        found.invalid,
        black_dn,
        (found.stopped,) if found.stopped else (),
    )


def calculate_attitude(
    matching: Matching,
    centroids: Centroids,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    hint: Hint | None = None,
) -> Solution:
    """Compute the attitude by QUEST over the selected stars, weighted by their verification votes (Erlank 2013 §4.4, §5.3.4), and
    reject false attitudes by residuals, hint, false-match bound, handedness and focal length."""
    chosen = matching.selected
    if matching.reason:
        return Solution(None, None, float("nan"), matching.reason)
    rows, unit = matching.row[chosen], matching.unit_cam[chosen]
    weights = matching.verification_votes[chosen].astype(float)
    reference = catalogue.icrs[rows].astype(float)
    reference /= np.linalg.norm(reference, axis=1, keepdims=True)
    quaternion = quest(unit, reference, weights)
    cam_from_icrs = matrix_from_quaternion(quaternion)
    miss_rad = np.linalg.norm(reference @ cam_from_icrs.T - unit, axis=1)
    if np.max(miss_rad) > parameters.tolerance_rad:
        pixels = float(np.max(miss_rad)) / camera.pixel_rad
        return Solution(None, None, float("nan"), f"matched stars do not fit one attitude: one is {pixels:.1f} px off")
    off_hint = _off_hint(matching.mode, hint, cam_from_icrs, camera, parameters)
    probability = false_match_probability(matching, cam_from_icrs, camera, catalogue, parameters)
    if off_hint or probability > parameters.max_false_probability:
        reason = off_hint or (
            f"{len(chosen)} of {len(matching.row)} centroids verified could be accidental: "
            f"bound {probability:.1e}, allowed {parameters.max_false_probability:.0e}"
        )
        return Solution(None, None, probability, reason)
    unsound = _unsound(matching, centroids, camera, catalogue, parameters) if parameters.proves else ""
    if unsound:
        return Solution(None, None, probability, unsound)
    sigma_rad = centroids.sigma_px[chosen] * camera.pixel_rad
    covariance = weighted_covariance_rad2(unit, weights, sigma_rad)
    residual_px = centroids.pixels[chosen] - camera.project(reference @ cam_from_icrs.T)
    matches = Matches(chosen.astype(np.int32), catalogue.hip[rows].astype(np.int32), weights, residual_px)
    return Solution(Attitude(quaternion, covariance), matches, probability, "")


def _unsound(
    matching: Matching,
    centroids: Centroids,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
) -> str:
    """Return why the frame may be mirrored or have another focal length, or ""."""
    chosen, bank = matching.selected, catalogue.icrs.astype(float)
    reference = bank[matching.row[chosen]]
    if not is_handed(matching.unit_cam[chosen], reference, parameters.tolerance_rad):
        return f"{len(chosen)} stars in a pattern that is its own mirror image"
    good = np.flatnonzero(np.isfinite(matching.unit_cam).all(axis=1))
    radius_px = parameters.tolerance_rad / camera.pixel_rad
    return focal_objection(centroids.pixels[good], np.searchsorted(good, chosen), reference, bank, camera, radius_px)


def hint_error_rad(camera: Camera, parameters: CubestarParameters) -> float:
    """Maximum angle of the boresight from the hint: D_max minus the field's half diagonal (Erlank 2013 §4.3.4)."""
    return max(parameters.assisted_radius_rad - _field_of(camera)[0], HINT_ERROR_RAD)


@lru_cache(maxsize=16)
def _field_of(camera: Camera) -> tuple[float, float]:
    """Half diagonal, rad, and solid angle, sr, of the field of view; cached because they are the same for every frame."""
    fov_h, fov_v = camera.fov_rad
    return camera.half_diagonal_rad, float(4 * np.arcsin(np.sin(fov_h / 2) * np.sin(fov_v / 2)))


def _off_hint(
    mode: Mode, hint: Hint | None, cam_from_icrs: Array, camera: Camera, parameters: CubestarParameters
) -> str:
    if mode is not Mode.ASSISTED or hint is None:
        return ""
    boresight = np.asarray(hint.boresight_icrs, float)
    off_rad = float(2 * np.arcsin(np.linalg.norm(boresight / np.linalg.norm(boresight) - cam_from_icrs[2]) / 2))
    limit_rad = hint_error_rad(camera, parameters)
    if off_rad <= limit_rad:
        return ""
    return f"boresight is {np.degrees(off_rad):.1f}° from the hint; {np.degrees(limit_rad):.1f}° allowed"


def false_match_probability(
    matching: Matching,
    cam_from_icrs: Array,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
) -> float:
    """Bound on the expected number of accidental identifications with as many stars as this one.

    Every matching table entry gives two hypotheses for a pair of centroids. A hint reduces their number to the share of
    boresights that it allows; in tracking, the hypotheses are the pairs near predicted stars.
    """
    n, k = len(matching.row), len(matching.selected)
    projected = camera.project(catalogue.icrs.astype(float) @ cam_from_icrs.T)
    in_view = max(1, int(np.count_nonzero(camera.contains(projected))))
    per_sr = in_view / _field_of(camera)[1]
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
    hint: Hint | None = None,
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
    kept = trace if trace is not None else Trace(clock)
    with kept.stage("detect"):
        detection = find_centroids(pixels, parameters, fast=fast)
    kept.keep("detection", detection)
    result = solve_centroids(
        detection.centroids, camera, catalogue, parameters, mode=mode, hint=hint, clock=clock, trace=kept
    )
    return replace(result, regions=detection.regions, notes=detection.notes + result.notes)


def solve_centroids(
    centroids: Centroids,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    *,
    mode: Mode = Mode.LOST_IN_SPACE,
    hint: Hint | None = None,
    clock: Callable[[], float] | None = None,
    trace: Trace | None = None,
) -> SolveResult:
    """As :func:`solve`, from given centroids, brightest first; the result has no regions."""
    kept = trace if trace is not None else Trace(clock)
    with kept.stage("match"):
        matching = match_stars(centroids, camera, catalogue, parameters, mode, hint)
    kept.keep("matching", matching)
    with kept.stage("attitude"):
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
        dict(kept.timing_s),
        (f"{over} faintest centroids not used: at most {parameters.max_centroids}",) if over > 0 else (),
    )

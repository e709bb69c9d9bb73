"""Reference chain: robust detection, Gaussian centroids, anchor search or blind figures, least squares with covariance.

Every solution has a false-match probability. Solutions above the limit are not returned. The chain shares no
identification code with the replicas of the documents' systems.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.aberration import aberrate
from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.failure_cause import CUT_TRAILS, MIRRORED
from gss.domain.results import Centroids, SolveResult, Turning
from gss.domain.sensor import Sensor
from gss.pipeline.chains.reference_frame import MeasuredFrame, turning_of
from gss.pipeline.detect import Detections, find_stars
from gss.pipeline.identify.blind_proof import with_aberration
from gss.pipeline.identify.faint import FIT_FLOOR_PX, AllMatches, Spots, match_all
from gss.pipeline.identify.focal_census import count_coinciding, focal_objection, plenty
from gss.pipeline.identify.near import BoundedPrior, identify_near
from gss.pipeline.identify.other_lens import identify_other_lens, lens_difference
from gss.pipeline.identify.pyramid import ACCEPT, PyramidMatch, identify_lost
from gss.pipeline.identify.soundness import is_few, is_handed
from gss.pipeline.identify.verify import RADIUS_SIGMA, Evidence, FrameDetections, SkyCatalogue, field_of
from gss.pipeline.kernels import ListLoops, are_compiled, kernels
from gss.pipeline.refine import Refined, refine
from gss.pipeline.trace import Clock, Trace
from gss.skytables.pairs import DistanceTable, distance_table_of_units

NAME = "reference"
MANY_MORE = 1.5
BESIDE_RAD = 0.05  # stars up to this far outside the field can contribute light to it
MOST_IN_LINE = 6
"""Number of identified stars up to which they are tested for lying in a line."""
DOUBTFUL = 1e-9  # false-match probability above which the mirrored list is searched as well
CENSUS_PX = 1.0  # the census of focal lengths has steps of half this size
DEEPER_ACCEPT = ACCEPT / 2  # half of the limit, because a second search can cause a second false match


@dataclass(frozen=True)
class KnownSky:
    """Catalogue data for a known camera: the stars used for identification, their pair distances, and ``deep``, the
    whole table, brightest first, for the identification of the remaining detections. ``deep_row``: row in ``deep`` of
    each star of ``sky``."""

    sky: SkyCatalogue
    pairs: DistanceTable
    deep: SkyCatalogue
    deep_row: NDArray[np.intp]


def known_sky(sky: SkyCatalogue, camera: Camera, faint_limit_mag: float, merge_px: float = 3.0) -> KnownSky:
    """Prepare the stars down to the camera's limit and their pair table. If the camera cannot resolve a pair, the
    fainter star of the pair is dropped."""
    order = np.argsort(sky.v_mag, kind="stable")
    deep = SkyCatalogue(sky.hip[order], sky.icrs[order], sky.v_mag[order])
    bright = np.arange(np.searchsorted(deep.v_mag, faint_limit_mag, side="right"))
    close = distance_table_of_units(deep.icrs[bright], 0.0, merge_px * camera.pixel_rad)
    keep = np.ones(len(bright), bool)
    keep[np.maximum(close.first, close.second)] = False
    rows = bright[keep]
    stars = SkyCatalogue(deep.hip[rows], deep.icrs[rows], deep.v_mag[rows])
    pairs = distance_table_of_units(stars.icrs, 2 * merge_px * camera.pixel_rad, camera.diagonal_rad)
    return KnownSky(stars, pairs, deep, rows)


def solve_known(
    pixels: NDArray[Any],
    camera: Camera,
    sensor: Sensor | None,
    stars: KnownSky,
    *,
    hint: BoundedPrior | None = None,
    deeper: Callable[[], KnownSky] | None = None,
    velocity_c: Array | None = None,
    exposure_s: float | None = None,
    fast: bool | None = None,
    clock: Clock | None = None,
) -> SolveResult:
    """Solve a (rows, cols) frame of a calibrated camera; with ``sensor`` None, photometry is derived from the frame.

    ``deeper``: returns fainter stars; called only if the frame shows many more stars than ``stars`` contains.
    ``velocity_c``: velocity of the observer relative to the barycentre, ICRS, in units of c, for aberration.
    ``exposure_s``: if given, the rate is measured from trails. ``fast``: see :func:`gss.pipeline.kernels.kernels`.
    """
    if pixels.shape != (camera.rows, camera.columns):
        raise BadInput(
            "the frame is not of this camera",
            expected=f"{camera.columns} x {camera.rows} pixels",
            got=" x ".join(str(n) for n in reversed(pixels.shape)),
            hint="name the camera that took it, or solve it with its field of view or blind",
        )
    trace = Trace(clock)
    fast = are_compiled() if fast is None else fast
    with trace.stage("detect"):
        detections = find_stars(
            pixels,
            psf_sigma_px=sensor.psf_sigma_px if sensor else None,
            saturation_dn=float(sensor.saturation_dn) if sensor else None,
            e_per_dn=sensor.gain_e_per_dn if sensor else 0.0,
            fast=fast,
        )
    turning = None
    if detections.trailed and exposure_s:
        with trace.stage("trails"):
            turning = turning_of(pixels, detections, camera, exposure_s, sensor, fast)
    return _identify_known(
        detections.centroids, camera, stars, deeper, hint, trace, detections, turning, velocity_c, fast
    )


def solve_centroids(
    centroids: Centroids,
    camera: Camera,
    stars: KnownSky,
    *,
    hint: BoundedPrior | None = None,
    velocity_c: Array | None = None,
    fast: bool | None = None,
    clock: Clock | None = None,
) -> SolveResult:
    """Solve given centroids, brightest first, as :func:`solve_known` does for a frame."""
    fast = are_compiled() if fast is None else fast
    return _identify_known(centroids, camera, stars, None, hint, Trace(clock), None, None, velocity_c, fast)


def _apparent(sky: SkyCatalogue, camera: Camera, cam_from_icrs: Array, velocity_c: Array | None) -> SkyCatalogue:
    """Return the sky with aberration applied to the stars near the field."""
    if velocity_c is None:
        return sky
    near = np.flatnonzero(sky.icrs @ cam_from_icrs[2] > np.cos(min(camera.half_diagonal_rad + BESIDE_RAD, np.pi)))
    icrs = sky.icrs.copy()
    icrs[near] = aberrate(icrs[near], velocity_c)
    return replace(sky, icrs=icrs)


def _identify_known(
    centroids: Centroids,
    camera: Camera,
    stars: KnownSky,
    deeper: Callable[[], KnownSky] | None,
    hint: BoundedPrior | None,
    trace: Trace,
    detections: Detections | None,
    turning: Turning | None,
    velocity_c: Array | None,
    fast: bool | None,
) -> SolveResult:
    notes = detections.notes if detections else ()
    frame = MeasuredFrame(NAME, camera, centroids, detections, notes, turning, trace)
    if detections is not None and detections.cut_trails:
        return frame.unsolved(CUT_TRAILS)
    view = field_of(centroids, camera, fast=fast)
    with trace.stage("identify"):
        result, note = _identify_field(view, camera, stars, hint, fast)
        if result.evidence is None and deeper is not None and len(view) > MANY_MORE * _expected(stars, camera):
            stars = deeper()
            again = identify_lost(view, stars.sky, stars.pairs, camera, accept=DEEPER_ACCEPT, fast=fast)
            result = result if again.evidence is None else again
    if note:
        frame = replace(frame, notes=(*notes, *note))
    evidence = result.evidence
    if evidence is None:
        with trace.stage("why not"):
            if _identified_mirrored(centroids, camera, stars, fast):
                return frame.unsolved(MIRRORED)
        return _with_other_lens(frame, result.reason, stars, velocity_c, fast)
    with trace.stage("focal length"):
        another = _another_focal_length(view, camera, stars.sky, evidence, fast)
    if another:
        return _with_other_lens(frame, another, stars, velocity_c, fast)
    with trace.stage("attitude"):
        matches = _name_all(view, camera, stars, evidence, centroids, detections, velocity_c, fast)
    seen_both = min(len(view), evidence.predicted)
    identified = int(np.count_nonzero(matches.fit.weight))
    probability = evidence.false_match_probability
    if is_few(identified, seen_both, probability):
        return frame.unsolved(f"the best solution identifies only {identified} of {seen_both} stars")
    in_line = identified <= MOST_IN_LINE and _is_mirror_image_of_itself(view, camera, stars, matches, fast)
    if in_line or probability > DOUBTFUL:
        with trace.stage("why not"):
            is_mirrored = _identified_mirrored(centroids, camera, stars, fast) > identified
        if is_mirrored or in_line:
            return frame.unsolved(
                MIRRORED if is_mirrored else f"{identified} stars in a pattern that is its own mirror image"
            )
    hip = stars.deep.hip[matches.stars]
    return frame.solved(matches.fit, view.centroid[matches.rows], hip, probability, velocity_c)


def _with_other_lens(
    frame: MeasuredFrame, reason: str, stars: KnownSky, velocity_c: Array | None, fast: bool | None
) -> SolveResult:
    """Solve with a lens near its calibration. The notes state the difference. Without a solution, state ``reason``."""
    with frame.trace.stage("other lens"):
        solution = identify_other_lens(frame.centroids, frame.camera, stars.sky, stars.pairs, fast=fast)
    if solution is None or is_few(
        len(solution.rows), min(len(frame.centroids), solution.predicted), solution.false_match_probability
    ):
        return frame.unsolved(reason)
    fit = with_aberration(solution, frame.centroids.pixels, stars.sky, velocity_c, frame.camera)
    frame = replace(frame, notes=(*frame.notes, lens_difference(fit, frame.camera)))
    rows, hip, probability = solution.rows, stars.sky.hip[solution.stars], solution.false_match_probability
    return frame.solved(fit, rows, hip, probability, velocity_c)


def _another_focal_length(
    view: FrameDetections, camera: Camera, sky: SkyCatalogue, evidence: Evidence, fast: bool | None
) -> str:
    radius_px = _coincidence_px(view)
    rows, stars = evidence.rows, evidence.stars
    coinciding = count_coinciding(view.pixels, rows, sky.icrs, stars, evidence.cam_from_icrs, camera, radius_px, fast)
    if plenty(coinciding, evidence.predicted, len(view)):
        return ""
    return focal_objection(view.pixels, rows, sky.icrs[stars], sky.icrs, camera, radius_px, fast)


def _name_all(
    view: FrameDetections,
    camera: Camera,
    stars: KnownSky,
    evidence: Evidence,
    centroids: Centroids,
    detections: Detections | None,
    velocity_c: Array | None,
    fast: bool | None,
) -> AllMatches:
    """Compute the attitude from the verified stars, then from every star that can be identified.

    Identification does not need aberration, which varies by at most a tenth of a pixel over a field, but the attitude does.
    """
    loops = kernels(fast).lists
    if loops is not None:
        return _name_all_compiled(view, camera, stars, evidence, centroids, detections, velocity_c, loops)
    deep = _apparent(stars.deep, camera, evidence.cam_from_icrs, velocity_c)
    picked = stars.deep_row[evidence.stars]

    start = evidence.cam_from_icrs

    def fit_to(rows: NDArray[np.intp], stars_of_rows: NDArray[np.intp], sigma_px: Array) -> Refined:
        return refine(view.pixels[rows], deep.icrs[stars_of_rows], sigma_px, camera, start)

    # In the search, the error of a star is at least the error of the lens calibration. In the fit, each star is
    # weighted by its centroid error.
    sigma_px = np.maximum(centroids.sigma_px[view.centroid], FIT_FLOOR_PX)
    first = fit_to(evidence.rows, picked, sigma_px[evidence.rows])
    start = first.cam_from_icrs
    spots = Spots(view.pixels, sigma_px, view.magnitude, detections.psf_sigma_px if detections else 1.0)
    matches = match_all(spots, deep, first, evidence.rows, picked, fit_to)
    return matches if matches is not None else AllMatches(evidence.rows, picked, first)


def _name_all_compiled(
    view: FrameDetections,
    camera: Camera,
    stars: KnownSky,
    evidence: Evidence,
    centroids: Centroids,
    detections: Detections | None,
    velocity_c: Array | None,
    loops: ListLoops,
) -> AllMatches:
    """Compute the result of :func:`_name_all` with compiled loops."""
    turn = np.array(evidence.cam_from_icrs, float)
    rows, star_rows, residual_px, weight, covariance, rms_px = loops.finish(
        loops.camera_numbers(camera),
        view.pixels,
        np.array(centroids.sigma_px, float),
        view.centroid,
        view.magnitude,
        float(detections.psf_sigma_px if detections else 1.0),
        stars.deep.arrays,
        np.zeros(3) if velocity_c is None else np.asarray(velocity_c, float),
        evidence.rows,
        evidence.stars,
        stars.deep_row,
        turn,
    )
    return AllMatches(rows, star_rows, Refined(camera, turn, residual_px, weight, rms_px, covariance=covariance))


def _expected(stars: KnownSky, camera: Camera) -> float:
    """Return the number of catalogue stars in an average frame."""
    return len(stars.sky) * camera.columns * camera.rows * camera.pixel_rad**2 / (4 * np.pi)


def _coincidence_px(view: FrameDetections) -> float:
    """Return the distance up to which a detection and a predicted star coincide."""
    return max(CENSUS_PX, RADIUS_SIGMA * view.typical_sigma_px)


def _is_mirror_image_of_itself(
    view: FrameDetections, camera: Camera, stars: KnownSky, matches: AllMatches, fast: bool | None
) -> bool:
    """True if the matched stars are so close to a line that they match a mirrored frame as well."""
    used = matches.fit.weight > 0
    radius_rad = _coincidence_px(view) * camera.pixel_rad
    measured, icrs = view.unit[matches.rows[used]], stars.deep.icrs[matches.stars[used]]
    return not is_handed(measured, icrs, radius_rad, fast=fast)


def _identified_mirrored(centroids: Centroids, camera: Camera, stars: KnownSky, fast: bool | None) -> int:
    """Return the number of stars identified in the left-right mirrored frame. More than 0 means that the file or the
    optics are mirrored, unless the frame itself is identified too."""
    if len(centroids) < 5:
        return 0
    view = field_of(centroids.mirrored(camera.columns), camera, fast=fast)
    evidence = identify_lost(view, stars.sky, stars.pairs, camera, only_first=True, fast=fast).evidence
    return 0 if evidence is None else len(evidence.rows)


def _identify_field(
    view: FrameDetections, camera: Camera, stars: KnownSky, hint: BoundedPrior | None, fast: bool | None
) -> tuple[PyramidMatch, tuple[str, ...]]:
    """Identify near the hint if there is one, then over the whole sky."""
    if hint is None:
        return identify_lost(view, stars.sky, stars.pairs, camera, fast=fast), ()
    near = identify_near(view, stars.sky, camera, hint, fast=fast)
    if near.evidence is not None:
        return near, ()
    note = f"not found near the hint ({near.reason}); the whole sky was searched"
    return identify_lost(view, stars.sky, stars.pairs, camera, fast=fast), (note,)

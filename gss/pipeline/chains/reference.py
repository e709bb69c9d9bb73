"""The best we know: robust detection, Gaussian centroids, k-vector pyramid or blind figures, least squares with covariance.

Every answer carries the probability that it is an accident, and none is given above the limit. It shares no
identification code with the replicas of the documents' systems.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.results import Attitude, Centroids, Matches, Outcome, SolveResult
from gss.domain.rotation import quaternion_from_matrix
from gss.domain.sensor import Sensor
from gss.pipeline.detect import Detections, find_stars
from gss.pipeline.identify.blind import identify_blind
from gss.pipeline.identify.kvector import PairTable, pair_table
from gss.pipeline.identify.near import Hint, identify_near
from gss.pipeline.identify.patterns import Level
from gss.pipeline.identify.pyramid import Found, identify_lost
from gss.pipeline.identify.verify import Field, Sky, field_of
from gss.pipeline.refine import Refined, refine
from gss.pipeline.trace import Clock, Trace

NAME = "reference"


@dataclass(frozen=True)
class KnownSky:
    """What the known-camera path needs of the catalogue: the stars a camera can show and their pair distances."""

    sky: Sky
    pairs: PairTable


def known_sky(sky: Sky, camera: Camera, faint_limit_mag: float, merge_px: float = 3.0) -> KnownSky:
    """Stars to the camera's limit, without the fainter of pairs that it cannot separate, and their pair table."""
    bright = np.flatnonzero(sky.v_mag <= faint_limit_mag)
    bright = bright[np.argsort(sky.v_mag[bright], kind="stable")]
    close = pair_table(sky.icrs[bright], 0.0, merge_px * camera.pixel_rad)
    keep = np.ones(len(bright), bool)
    keep[np.maximum(close.first, close.second)] = False
    rows = bright[keep]
    kept = Sky(sky.hip[rows], sky.icrs[rows], sky.v_mag[rows])
    return KnownSky(kept, pair_table(kept.icrs, 2 * merge_px * camera.pixel_rad, camera.diagonal_rad))


def solve_known(
    pixels: NDArray[np.generic],
    camera: Camera,
    sensor: Sensor | None,
    stars: KnownSky,
    *,
    hint: Hint | None = None,
    clock: Clock | None = None,
) -> SolveResult:
    """Solve a (rows, cols) frame of a calibrated camera; ``sensor`` None leaves photometry to the frame itself."""
    if pixels.shape != (camera.rows, camera.columns):
        raise BadInput(
            "the frame is not of this camera",
            expected=f"{camera.columns} x {camera.rows} pixels",
            got=" x ".join(str(n) for n in reversed(pixels.shape)),
            hint="name the camera that took it, or solve it with its field of view or blind",
        )
    trace = Trace(clock)
    with trace.stage("detect"):
        found = find_stars(
            pixels,
            psf_sigma_px=sensor.psf_sigma_px if sensor else None,
            saturation_dn=float(sensor.saturation_dn) if sensor else None,
            e_per_dn=sensor.gain_e_per_dn if sensor else 0.0,
        )
    return _identify_known(found.centroids, camera, stars, hint, trace, found)


def solve_centroids(
    centroids: Centroids, camera: Camera, stars: KnownSky, *, hint: Hint | None = None, clock: Clock | None = None
) -> SolveResult:
    """The same from centroids alone, brightest first."""
    return _identify_known(centroids, camera, stars, hint, Trace(clock), None)


def _identify_known(
    centroids: Centroids, camera: Camera, stars: KnownSky, hint: Hint | None, trace: Trace, found: Detections | None
) -> SolveResult:
    view = field_of(centroids, camera)
    notes = found.notes if found else ()
    with trace.stage("identify"):
        result, said = _where(view, camera, stars, hint)
    notes += said
    regions = found.regions if found else ()
    evidence = result.evidence
    if evidence is None:
        return SolveResult(
            NAME,
            Outcome.NONE,
            result.reason,
            camera,
            regions,
            centroids,
            None,
            None,
            float("nan"),
            dict(trace.timing_s),
            notes,
        )
    with trace.stage("attitude"):
        fit = refine(
            view.pixels[evidence.rows],
            stars.sky.icrs[evidence.stars],
            view.sigma_px[evidence.rows],
            camera,
            evidence.cam_from_icrs,
        )
    return SolveResult(
        NAME,
        Outcome.SOLVED,
        "",
        camera,
        regions,
        centroids,
        _matches(view.centroid[evidence.rows], stars.sky.hip[evidence.stars], fit),
        _attitude(fit),
        evidence.false_match_probability,
        dict(trace.timing_s),
        notes,
    )


def _where(view: Field, camera: Camera, stars: KnownSky, hint: Hint | None) -> tuple[Found, tuple[str, ...]]:
    """Near the hint if there is one, then the whole sky."""
    if hint is None:
        return identify_lost(view, stars.sky, stars.pairs, camera), ()
    near = identify_near(view, stars.sky, camera, hint)
    if near.evidence is not None:
        return near, ()
    note = f"not found near the hint ({near.reason}); the whole sky was searched"
    return identify_lost(view, stars.sky, stars.pairs, camera), (note,)


def solve_foreign(
    pixels: NDArray[np.generic],
    fov_range_rad: tuple[float, float],
    sky: Sky,
    level: Callable[[float], Level],
    *,
    clock: Clock | None = None,
) -> SolveResult:
    """Solve a frame of an uncalibrated camera with square pixels whose horizontal field of view lies in a range.

    The result's ``camera`` carries the fitted focal length and radial distortion.
    """
    trace = Trace(clock)
    with trace.stage("detect"):
        found = find_stars(pixels)
    centroids = found.centroids
    shape = (int(pixels.shape[1]), int(pixels.shape[0]))
    with np.errstate(divide="ignore"):
        magnitude = -2.5 * np.log10(np.maximum(centroids.flux_dn, 1e-12))
    with trace.stage("identify"):
        result = identify_blind(centroids.pixels, magnitude, centroids.sigma_px, shape, fov_range_rad, sky, level)
    notes = found.notes
    if found.streak_px:
        notes = (
            *notes,
            f"stars are trailed by about {found.streak_px:.0f} px; positions are the middles of the trails",
        )
    if result.solved is None:
        guess = Camera.from_fov(*shape, float(np.sqrt(fov_range_rad[0] * fov_range_rad[1])))
        return SolveResult(
            NAME,
            Outcome.NONE,
            result.reason,
            guess,
            found.regions,
            centroids,
            None,
            None,
            float("nan"),
            dict(trace.timing_s),
            notes,
        )
    solved = result.solved
    return SolveResult(
        NAME,
        Outcome.SOLVED,
        "",
        solved.fit.camera,
        found.regions,
        centroids,
        _matches(solved.rows, sky.hip[solved.stars], solved.fit),
        _attitude(solved.fit),
        solved.false_match_probability,
        dict(trace.timing_s),
        notes,
    )


def _matches(rows: NDArray[np.intp], hip: NDArray[np.int32], fit: Refined) -> Matches:
    return Matches(rows.astype(np.int32), hip.astype(np.int32), fit.weight, fit.residual_px)


def _attitude(fit: Refined) -> Attitude:
    return Attitude(quaternion_from_matrix(fit.cam_from_icrs), fit.covariance_rad2)

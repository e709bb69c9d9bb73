"""Verification of a blind candidate: alternate matching and refinement, then the probability that the matches are accidental."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.aberration import aberrate
from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.pipeline.identify.false_match import brightness_tail, false_match_probability, match_tail
from gss.pipeline.identify.verify import SkyCatalogue, in_view, pair_up
from gss.pipeline.refine import Refined, refine

WIDE_HALF_DIAGONAL_RAD = np.radians(12.0)
WIDE_STARS = 20
WIDE_LENS = ("k1", "k2", "p1", "p2")
ENOUGH_FOR_MORE = 8
MERGE_PX = 2.5
BRIGHTNESS_GATE_MAG = 1.8  # largest difference of brightness that filter, colour and saturation can cause
ACQUIRE = (0.003, 0.008)  # acquisition radii, relative to the frame's width, for a good lens and for strong distortion
# Coincidences are counted within these fractions of the acquisition radius and among these numbers of the brightest
# detections. The most significant count is used, with a correction for the number of counts. Small numbers and radii
# help because false detections are mostly faint and the prediction is accurate for good lenses.
COUNT_WITHIN = (1.0, 0.5, 0.2)
COUNT_AMONG = (8, 16, 40, 10_000)


@dataclass(frozen=True)
class BlindSolution:
    """Accepted identification: rows of the detections and of the sky, with the fitted geometry."""

    rows: NDArray[np.intp]
    stars: NDArray[np.intp]
    fit: Refined
    predicted: int
    false_match_probability: float


def prove(
    camera: Camera,
    cam_from_icrs: Array,
    pixels: Array,
    magnitude: Array,
    sigma_px: Array,
    sky: SkyCatalogue,
    hypotheses: float,
    also: tuple[str, ...] = (),
    calibration: Camera | None = None,
) -> BlindSolution | None:
    """Match and refine alternately, from a narrow and from a wide acquisition radius. Return the more certain result.

    ``also``: camera parameters that are free in addition to focal length and lens once enough stars are matched.
    ``calibration``: camera near which the fitted camera lies; None: an uncalibrated camera. The false-match probability
    uses the first prediction, before any fit.
    """
    results = [
        _prove(
            camera,
            cam_from_icrs,
            pixels,
            magnitude,
            sigma_px,
            sky,
            hypotheses,
            part * camera.columns,
            also,
            calibration,
        )
        for part in ACQUIRE
    ]
    good = [r for r in results if r is not None]
    return min(good, key=lambda r: r.false_match_probability) if good else None


def with_aberration(
    solution: BlindSolution,
    pixels: Array,
    sky: SkyCatalogue,
    velocity_c: Array | None,
    calibration: Camera | None = None,
) -> Refined:
    """Return the fit of a solution, repeated with aberration applied to the stars if the observer's velocity is given."""
    fit = solution.fit
    if velocity_c is None:
        return fit
    used = fit.weight > 0
    rows, stars = solution.rows[used], solution.stars[used]
    again = refine(
        pixels[rows],
        aberrate(sky.icrs[stars], velocity_c),
        1 / np.sqrt(fit.weight[used]),
        fit.camera,
        fit.cam_from_icrs,
        fit_focal="focal" in fit.parameters,
        fit_lens=fit.parameters[4:] if "focal" in fit.parameters else fit.parameters[3:],
        calibration=calibration,
    )
    residual_px, weight = fit.residual_px.copy(), np.zeros(len(used))
    residual_px[used], weight[used] = again.residual_px, again.weight
    return replace(again, residual_px=residual_px, weight=weight)


def _is_wide(camera: Camera) -> bool:
    """True if decentring and higher-order distortion are measurable."""
    return bool(camera.half_diagonal_rad > WIDE_HALF_DIAGONAL_RAD)


def _visible(sky: SkyCatalogue, camera: Camera, cam_from_icrs: Array, count: int) -> tuple[NDArray[np.intp], Array]:
    """Return the brightest ``count`` stars in view and their pixels, without faint companions blended with a brighter star."""
    rows, pixels = in_view(sky, camera, cam_from_icrs)
    rows, pixels = rows[:count], pixels[:count]
    keep = np.ones(len(rows), bool)
    if len(rows) > 1:
        keep[cKDTree(pixels).query_pairs(MERGE_PX, output_type="ndarray").max(axis=1)] = False
    return rows[keep], pixels[keep]


def _prove(
    camera: Camera,
    cam_from_icrs: Array,
    pixels: Array,
    magnitude: Array,
    sigma_px: Array,
    sky: SkyCatalogue,
    hypotheses: float,
    acquire_px: float,
    also: tuple[str, ...],
    calibration: Camera | None,
) -> BlindSolution | None:
    count = int(1.5 * len(pixels)) + 5
    sigma = np.maximum(sigma_px, 0.15)
    radius = acquire_px
    fit = Refined(camera, cam_from_icrs, np.zeros((0, 2)), np.zeros(0), radius)
    first, expected = np.zeros((0, 2)), 0
    fitted: tuple[object, ...] = ()
    for round_ in range(6):
        visible, predicted = _visible(sky, fit.camera, fit.cam_from_icrs, count)
        if len(visible) < 4:
            return None
        p, m = pair_up(predicted, pixels, np.full(len(visible), radius))
        if len(m) < 5:
            return None
        if round_ == 0:
            first = np.full((len(sky), 2), np.inf)
            first[visible] = predicted
            expected = len(visible)
        lens: tuple[str, ...] = ("k1",)
        if calibration and len(m) < ENOUGH_FOR_MORE:
            lens = ()
        elif len(m) >= WIDE_STARS and round_ >= 2 and _is_wide(fit.camera):
            lens = WIDE_LENS
        lens += also if len(m) >= ENOUGH_FOR_MORE or calibration else ()
        before, fitted = fitted, (lens, *m, *visible[p])
        if fitted != before:  # otherwise the fit would give the same result
            try:
                fit = refine(
                    pixels[m],
                    sky.icrs[visible[p]],
                    sigma[m],
                    fit.camera,
                    fit.cam_from_icrs,
                    fit_focal=True,
                    fit_lens=lens,
                    calibration=calibration,
                )
            except np.linalg.LinAlgError:
                return None
            if not np.isfinite(fit.rms_px):
                return None
        radius = (
            float(np.clip(4.0 * fit.rms_px, 0.8, max(acquire_px * 0.7, 0.8)))
            if round_ < 3
            else float(np.clip(3.5 * fit.rms_px, 0.7, 3.5))
        )
    difference = magnitude[m] - sky.v_mag[visible[p]]
    keep = (fit.weight > 0) & (np.abs(difference - np.median(difference)) < BRIGHTNESS_GATE_MAG)
    rows, stars = m[keep], visible[p][keep]
    if len(rows) < 5 or not _plausible(fit):
        return None
    spread = float(np.hypot(np.std(sky.v_mag[visible]), np.std(magnitude)))
    brightness = brightness_tail(magnitude[rows], sky.v_mag[stars], spread)
    offset = np.linalg.norm(first[stars] - pixels[rows], axis=1)
    tail = _tail(rows, offset, acquire_px, expected, len(pixels), camera, brightness)
    fit = replace(fit, residual_px=fit.residual_px[keep], weight=fit.weight[keep])
    return BlindSolution(rows, stars, fit, len(visible), false_match_probability(hypotheses, tail))


def _tail(
    rows: NDArray[np.intp],
    offset: Array,
    acquire_px: float,
    expected: int,
    detections: int,
    camera: Camera,
    brightness: float,
) -> float:
    """Return the probability that randomly scattered detections coincide with the first prediction this often.

    ``offset``: (m,) px of the matched detections ``rows`` before any fit, which would reduce the offsets. Four
    detections are not counted because they form the figure.
    """
    area_px2 = camera.columns * camera.rows
    tails = []
    for part in COUNT_WITHIN:
        radius = part * acquire_px
        chance = min(1.0, expected * np.pi * radius**2 / area_px2)
        for among in COUNT_AMONG:
            coinciding = int(((offset <= radius) & (rows < among)).sum())
            tails.append(match_tail(coinciding - 4, max(min(detections, among) - 4, 0), chance, brightness))
    return min(1.0, min(tails) * len(tails) * len(ACQUIRE))


def _plausible(fit: Refined) -> bool:
    """True if the fit is plausible, i.e. has a distortion below a fifth at the corners and small residuals."""
    k1 = fit.camera.distortion.k1 if isinstance(fit.camera.distortion, Brown) else 0.0
    return abs(k1) * np.tan(min(fit.camera.half_diagonal_rad, 1.2)) ** 2 < 0.2 and fit.rms_px < 3.0

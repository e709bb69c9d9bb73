"""Star detection: a matched filter and a threshold above the local sky, then tests of shape that only star images pass."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.results import Centroids, Region
from gss.pipeline.background import Background
from gss.pipeline.kernels import NUMPY, Kernels, kernels
from gss.pipeline.peaks import STREAK_RATIO, Peaks, find_peaks, repeat_single_test
from gss.pipeline.psf import Measured, adaptive_shapes, cut_stamps, measure_stars, second_moments, widths_px
from gss.pipeline.small import close_pairs, median, quantile

THRESHOLD_SIGMA = 5.5
MAX_STARS = 400
SIGMA_RANGE_PX = (0.55, 6.0)
BRIGHTEST, BRIGHT_SNR = 12, 15.0  # stars used to decide whether a known camera's stars are trailed
# Windows of the measurement of stars contain trails of 20 px. A longer trail is found in parts, all of which can be
# displaced by the same amount, so that residuals do not show the error. Measured in larger windows, trails of 20 px
# have standard deviations up to 6.9 px, trails of 36 px or more at least 8 px.
LONG_TRAIL_PX, TRAIL_HALF_PX, MAX_TRAIL_SIGMA_PX = 14.0, 20, 7.5
TRAILED_RATIO = 1.5  # ratio to the camera's own variance above which a star is treated as trailed


@dataclass(frozen=True)
class MeasuredWindows:
    """Windows in which stars were measured. ``stars`` (n,): the peaks that were fitted, ``fit``: their fits, ``half_px``: half the
    side of a window without its middle pixel. ``usable`` (n,): fits that are stars; ``order``: the stars among the fits,
    brightest first."""

    peaks: Peaks
    stars: NDArray[np.intp]
    fit: Measured
    half_px: int
    usable: NDArray[np.bool_]
    order: NDArray[np.intp]

    def regions(self, limit: int = 200) -> tuple[Region, ...]:
        """Return the windows of the stars, then those of at most ``limit`` rejected detections with the reason, brightest
        first."""
        fit, stars, order, rejected = self.fit, self.stars, self.order, np.flatnonzero(~self.usable)[:limit]
        reasons = ["outside the detector" if good else "no star shape" for good in fit.good[rejected].tolist()]
        hot = np.flatnonzero(self.peaks.single)[:limit]
        ones, zeros, top = np.ones(len(hot), int), np.zeros(len(hot)), self.peaks.snr[hot] * self.peaks.noise[hot]
        flux = np.nan_to_num(fit.flux)
        return (
            *self._windows(stars[order], fit.area[order], fit.peak[order], flux[order], [""] * len(order)),
            *self._windows(stars[rejected], fit.area[rejected], fit.peak[rejected], flux[rejected], reasons),
            *self._windows(hot, ones, top, zeros, ["single pixel, row or column"] * len(hot)),
        )

    def _windows(
        self, chosen: NDArray[np.intp], area: NDArray[np.integer], peak: Array, flux: Array, reasons: list[str]
    ) -> Iterator[Region]:
        """Return the windows of the chosen peaks."""
        if not reasons:
            return iter(())
        col, row, half = self.peaks.col[chosen], self.peaks.row[chosen], self.half_px
        columns = (col - half, row - half, col + half, row + half, area, peak, flux)
        rows = zip(*(c.tolist() for c in columns), reasons, strict=True)
        return map(partial(tuple.__new__, Region), rows)  # half the time of Region._make


@dataclass(frozen=True)
class Detections:
    """Stars detected in one frame, with the frame's background and point-spread function.

    ``psf_covariance_px2``: (2, 2), shared by the stars. ``streak_px``: length of the trail in px (0 for round stars);
    ``streak_direction_rad``: its direction from +col towards +row. ``loops``: implementation used, numpy or numba.
    ``trailed``: True if stars are larger than the camera's point-spread function or elongated. ``cut_trails``: True if
    they are longer than the detection's filter, so that positions are those of parts of trails.
    """

    centroids: Centroids
    windows: MeasuredWindows
    background: Background
    psf_covariance_px2: Array
    streak_px: float
    streak_direction_rad: float
    notes: tuple[str, ...]
    loops: str = NUMPY.name
    trailed: bool = False
    cut_trails: bool = False

    @property
    def regions(self) -> tuple[Region, ...]:
        """Return the windows of the stars and of rejected detections; see :meth:`MeasuredWindows.regions`."""
        return self.windows.regions()

    @property
    def psf_sigma_px(self) -> float:
        """Return the width of a circular point-spread function with the same area."""
        return float(np.linalg.det(self.psf_covariance_px2) ** 0.25)


def find_stars(
    pixels: NDArray[Any],
    *,
    psf_sigma_px: float | None = None,
    saturation_dn: float | None = None,
    e_per_dn: float = 0.0,
    threshold_sigma: float = THRESHOLD_SIGMA,
    max_stars: int = MAX_STARS,
    fast: bool | None = None,
) -> Detections:
    """Detect the stars of a (rows, cols) frame of any real type, brightest first.

    ``psf_sigma_px`` None: the width is estimated from the frame (images from unknown cameras), trails included.
    ``saturation_dn``: pixels at or above it are saturated and not fitted; None: detected from the frame (see ``_ceiling``).
    ``fast``: see :func:`gss.pipeline.kernels.kernels`.
    """
    loops = kernels(fast)
    image = _checked(pixels) if loops.frames is None else _for_loops(_checked(pixels))
    ceiling = _ceiling(image) if saturation_dn is None else saturation_dn
    notes: list[str] = []
    psf_is_given = psf_sigma_px is not None
    sigma = psf_sigma_px if psf_sigma_px is not None else 1.0
    covariance = np.diag([sigma**2 + 1 / 12] * 2)
    pass_one = find_peaks(image, covariance, threshold_sigma, notes, loops)
    sizes = _sizes if loops.frames is None else loops.frames.sizes
    usual, large = sizes(image, pass_one, covariance, ceiling) if psf_is_given else (0.0, 0.0)
    trailed = large > TRAILED_RATIO * covariance[0, 0]
    if usual > TRAILED_RATIO * covariance[0, 0]:
        measured = _measure_psf(image, pass_one, ceiling)
        if measured is not None:
            covariance = measured
            notes.clear()
            pass_one = find_peaks(image, covariance, threshold_sigma, notes, loops)
            notes.append(
                "stars are larger than the camera's point-spread function: the camera rotated, or is out of focus"
            )
    if not psf_is_given:
        measured = _measure_psf(image, pass_one, ceiling)
        if measured is not None:
            moved = np.abs(np.log(np.linalg.eigvalsh(measured) / covariance[0, 0])).max()
            covariance = measured
            if moved > 0.8:
                notes.clear()
                pass_one = find_peaks(image, covariance, threshold_sigma, notes, loops)
            else:
                pass_one = repeat_single_test(image, pass_one, covariance, loops)
    detections = _measure(image, pass_one, covariance, ceiling, e_per_dn, max_stars, notes, loops)
    # A faint trail is found in parts, none of which is bright enough to show its length.
    can_be_cut = detections.streak_px > LONG_TRAIL_PX or (psf_is_given and not large)
    cut = can_be_cut and _long_axis_px(image, pass_one) > MAX_TRAIL_SIGMA_PX
    return replace(detections, trailed=trailed or detections.streak_px > 0, cut_trails=cut)


def _checked(pixels: NDArray[Any]) -> NDArray[Any]:
    image = np.asarray(pixels)
    if image.ndim != 2 or min(image.shape) < 8 or image.dtype.kind not in "uif":
        raise BadInput(
            "the array is not a valid frame",
            expected="two axes of at least 8 real pixels",
            got=f"{image.dtype} {image.shape}",
        )
    if image.dtype.kind == "f" and not np.isfinite(image).all():
        raise BadInput("the frame contains invalid pixel values", expected="finite pixels", got="NaN or infinity")
    return image


def _for_loops(image: NDArray[Any]) -> NDArray[Any]:
    """Return the frame as one of the three types for which the loops are compiled: uint8, uint16 or float64."""
    return np.require(image, image.dtype if image.dtype in (np.uint8, np.uint16) else float, ["C", "A", "W"])


def _ceiling(image: NDArray[Any]) -> float:
    """Return the lowest value that counts as saturated: the frame's maximum if several pixels have it, otherwise infinity."""
    top = image.max()
    floor_ = np.median(image[::8, ::8])
    enough = int((image == top).sum()) >= 6 and float(top) > float(floor_) + 20
    return float(top) if enough else float("inf")


def _sizes(image: NDArray[Any], peaks: Peaks, covariance: Array, ceiling: float) -> tuple[float, float]:
    """Return two sizes of the bright stars in px²: the median of the variance along the long axis, and the upper
    quartile of half the trace. Both are close to the camera's own variance if the camera was in focus and did not
    rotate. A rotation about the boresight affects only the second size. Return (0, 0) if there are fewer than three
    bright stars."""
    pick = np.flatnonzero(~peaks.single & (peaks.snr > BRIGHT_SNR))[:BRIGHTEST]
    if len(pick) < 3:
        return 0.0, 0.0
    half = int(np.ceil(4 * np.sqrt(covariance[0, 0])))
    moments = np.array(second_moments(image, peaks.col[pick], peaks.row[pick], peaks.sky[pick], half, ceiling))
    if not np.isfinite(moments).all():
        return 0.0, 0.0
    xx, xy, yy = (median(m) for m in moments)
    longest = widths_px(np.array([[xx, xy], [xy, yy]]))[1]
    return longest**2, quantile((moments[0] + moments[2]) / 2, 0.75)


def _long_axis_px(image: NDArray[Any], peaks: Peaks) -> float:
    """Return the median standard deviation of bright stars along their long axis, measured in windows that contain a trail
    of 40 px; 0 if there are fewer than three."""
    pick = np.flatnonzero(~peaks.single & (peaks.snr > 8))[:30]
    if len(pick) < 3:
        return 0.0
    stamps = cut_stamps(image, peaks.col[pick], peaks.row[pick], peaks.sky[pick], TRAIL_HALF_PX, float("inf"))
    shapes = adaptive_shapes(stamps, 1.5)
    if shapes.good.sum() < 3:
        return 0.0
    return float(np.median(np.sqrt(np.linalg.eigvalsh(shapes.covariance[shapes.good])[:, 1])))


def _measure_psf(image: NDArray[Any], peaks: Peaks, ceiling: float) -> Array | None:
    """Return the (2, 2) covariance of the median bright star, or None if there are fewer than three."""
    pick = np.flatnonzero(~peaks.single & (peaks.snr > 8))[:30]
    if len(pick) < 3:
        return None
    half = 9
    stamps = cut_stamps(image, peaks.col[pick], peaks.row[pick], peaks.sky[pick], half, float("inf"))
    shapes = adaptive_shapes(stamps, 1.5)
    touched = np.any(
        (
            image[
                np.clip(stamps.row[:, None] + stamps.dy.astype(int), 0, image.shape[0] - 1),
                np.clip(stamps.col[:, None] + stamps.dx.astype(int), 0, image.shape[1] - 1),
            ]
            >= ceiling
        ),
        axis=1,
    )
    good = shapes.good & ~touched if (shapes.good & ~touched).sum() >= 3 else shapes.good
    if good.sum() < 3:
        return None
    middle = np.median(shapes.covariance[good], axis=0)
    values, vectors = np.linalg.eigh(middle)
    values = np.clip(values, SIGMA_RANGE_PX[0] ** 2, SIGMA_RANGE_PX[1] ** 2)
    if values[1] / values[0] < STREAK_RATIO**2 / 1.3:
        return np.asarray(np.eye(2) * np.sqrt(values[0] * values[1]))
    return np.asarray(vectors @ np.diag(values) @ vectors.T)


def _measure(
    image: NDArray[Any],
    peaks: Peaks,
    covariance: Array,
    ceiling: float,
    e_per_dn: float,
    max_stars: int,
    notes: list[str],
    loops: Kernels,
) -> Detections:
    low, high = widths_px(covariance)
    half = int(np.clip(np.ceil(2.6 * high), 2, 14))
    stars = np.flatnonzero(~peaks.single)
    separate, measure = (
        (_separate_stars, measure_stars) if loops.frames is None else (loops.frames.separate, loops.frames.measure)
    )
    col, row, sky = peaks.col[stars], peaks.row[stars], peaks.sky[stars]
    pick = separate(image, col, row, peaks.snr[stars], sky, high)[: 3 * max_stars]
    stars, col, row, sky = stars[pick], col[pick], row[pick], sky[pick]
    fit = Measured(*measure(image, col, row, sky, peaks.noise[stars], covariance, half, ceiling, e_per_dn))
    outside = (fit.col < -0.5) | (fit.row < -0.5) | (fit.col > image.shape[1] - 0.5) | (fit.row > image.shape[0] - 0.5)
    usable = fit.good & ~outside
    accepted = np.flatnonzero(usable)
    order = accepted[np.argsort(-fit.flux[accepted], kind="stable")]
    if len(order) > max_stars:
        notes.append(f"{len(order)} stars detected; only the brightest {max_stars} are used")
        order = order[:max_stars]
    sigma_px = fit.sigma_px * (1 + 0.5 * fit.touched)
    centroids = Centroids(fit.col, fit.row, fit.flux, fit.peak, fit.area, sigma_px).take(order)
    n_single = int(np.count_nonzero(peaks.single))
    if n_single > 20:
        notes.append(f"{n_single} single bright pixels were excluded as hot pixels")
    is_streak = high / low >= STREAK_RATIO
    direction_rad = 0.5 * float(np.arctan2(2 * covariance[0, 1], covariance[0, 0] - covariance[1, 1])) % np.pi
    return Detections(
        centroids,
        MeasuredWindows(peaks, stars, fit, half, usable, order),
        peaks.background,
        covariance,
        float(np.sqrt(12 * (high**2 - low**2))) if is_streak else 0.0,
        direction_rad if is_streak else 0.0,
        tuple(notes),
        loops.name,
    )


def _separate_stars(
    image: NDArray[Any],
    cols: NDArray[np.intp],
    rows: NDArray[np.intp],
    snrs: Array,
    sky: Array,
    width: float,
) -> NDArray[np.intp]:
    """Return the indices of the separate stars of n peaks. A peak is dropped if there is no dip between it and a
    brighter neighbour, or if it is lost in the wings of the neighbour."""
    reach = max(3.0, 2.2 * width)
    if len(cols) < 2:
        return np.arange(len(cols))
    first, second = close_pairs(cols, rows, 3 * reach)
    col, row, snr = (a.tolist() for a in (cols, rows, snrs))
    drop = np.zeros(len(cols), bool)
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        if drop[i]:
            continue
        distance = math.hypot(col[i] - col[j], row[i] - row[j])
        if distance > 3 * reach:
            continue
        ratio = snr[j] / snr[i]
        if (
            distance < reach * 0.8
            or (distance < reach and ratio < 0.5)
            or ratio < 0.02
            or (distance < 2 * reach and ratio < 0.05)
        ):
            drop[j] = True
            continue
        t = np.linspace(0, 1, int(distance) + 2)[1:-1]
        path = image[
            np.rint(row[i] + t * (row[j] - row[i])).astype(int), np.rint(col[i] + t * (col[j] - col[i])).astype(int)
        ]
        lower = float(image[row[j], col[j]]) - sky[j]
        if float(path.min()) - sky[j] > 0.8 * lower:
            drop[j] = True
    return np.flatnonzero(~drop)

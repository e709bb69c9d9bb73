"""Where stars may be: local maxima of the frame under a matched filter, and which of them are single bright pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gss.domain.angles import Array
from gss.pipeline.background import Background, measure_background, pixel_noise

MAX_PEAKS = 4000  # counted budget: brightest first, the rest is said to be left out
STREAK_RATIO = 1.7
BINOMIAL_GAIN = 256.0
SINGLE_SHARE = 0.35  # of the light that a star must have beside its brightest pixel


def _binomial_sum(image: NDArray[Any]) -> NDArray[Any]:
    """Sum of 5x5 pixels under binomial weights (gain 256, sigma 1 px), in 16 bits for 8-bit frames. Edges repeat."""
    kind = np.uint16 if image.dtype == np.uint8 else np.float32
    wide = np.empty((image.shape[0] + 4, image.shape[1] + 4), kind)
    wide[2:-2, 2:-2] = image
    wide[:2, 2:-2], wide[-2:, 2:-2] = image[0], image[-1]
    wide[:, :2], wide[:, -2:] = wide[:, 2:3], wide[:, -3:-2]
    for _ in range(4):
        wide = wide[:, :-1] + wide[:, 1:]
    for _ in range(4):
        wide = wide[:-1] + wide[1:]
    return wide


def _filtered(image: NDArray[Any], covariance: Array) -> tuple[NDArray[Any], float]:
    """The frame under a filter close to its point-spread function, and the filter's gain. Noise is measured on the result."""
    low, high = np.sqrt(np.linalg.eigvalsh(covariance))
    if high < 1.6:
        return _binomial_sum(image), BINOMIAL_GAIN
    if high / low < STREAK_RATIO:
        smooth = ndimage.gaussian_filter(image.astype(np.float32), float(np.sqrt(low * high)), mode="nearest")
        return np.asarray(smooth), 1.0
    half = int(np.ceil(2.5 * high))
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    q = np.linalg.inv(covariance)
    kernel = np.exp(-0.5 * (q[0, 0] * x * x + 2 * q[0, 1] * x * y + q[1, 1] * y * y))
    from scipy.signal import oaconvolve

    wide = np.pad(image.astype(np.float32), half, mode="edge")
    return np.asarray(oaconvolve(wide, (kernel / kernel.sum()).astype(np.float32), mode="valid")), 1.0


@dataclass(frozen=True)
class Peaks:
    """Local maxima of the filtered frame, brightest first: position, significance; backgrounds of raw and filtered."""

    col: NDArray[np.intp]
    row: NDArray[np.intp]
    snr: Array
    sky: Array
    noise: Array
    single: NDArray[np.bool_]
    background: Background


def find_peaks(image: NDArray[Any], covariance: Array, threshold_sigma: float, notes: list[str]) -> Peaks:
    """Local maxima of a (rows, cols) frame under a filter as wide as its stars, above ``threshold_sigma``."""
    smooth, gain = _filtered(image, covariance)
    background = measure_background(smooth)
    raw_background = _unfiltered(image, background, gain)
    row, col = _above(smooth, background, threshold_sigma)
    level, noise = background.at(col, row)
    snr = (smooth[row, col] - level) / noise
    keep = np.flatnonzero((snr > threshold_sigma) & _is_maximum(smooth, row, col))
    keep = keep[np.argsort(-snr[keep], kind="stable")]
    if len(keep) > MAX_PEAKS:
        notes.append(f"{len(keep)} peaks above threshold; the brightest {MAX_PEAKS} were looked at")
        keep = keep[:MAX_PEAKS]
    row, col, snr = row[keep], col[keep], snr[keep]
    sky, raw_noise = raw_background.at(col, row)
    single = _is_single_pixel(image, row, col, sky, raw_noise, covariance)
    return Peaks(col, row, snr, sky, raw_noise, single, raw_background)


def _unfiltered(image: NDArray[Any], background: Background, gain: float) -> Background:
    """Level and noise of single pixels from the mesh of a filtered frame; ``gain``: of the filter on a flat frame."""
    level = background.scaled(1 / gain, 1.0)
    return level.scaled(1.0, pixel_noise(image, level) / float(np.median(background.noise)))


def single_again(image: NDArray[Any], peaks: Peaks, covariance: Array) -> Peaks:
    """Judge the shapes anew once the frame's own point-spread function is known."""
    single = _is_single_pixel(image, peaks.row, peaks.col, peaks.sky, peaks.noise, covariance)
    return replace(peaks, single=single)


def _above(smooth: NDArray[Any], background: Background, sigma: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pixels that may be above threshold: each tile against its own lowest threshold."""
    tile = background.tile_px
    lowest = background.lowest_threshold(sigma)
    if smooth.dtype.kind == "u":
        lowest = np.clip(np.floor(lowest), 0, np.iinfo(smooth.dtype).max)
    per_col = np.repeat(lowest, tile, axis=1)[:, : smooth.shape[1]].astype(smooth.dtype)
    hit = np.empty(smooth.shape, bool)
    for k in range(len(lowest)):
        np.greater(smooth[k * tile : (k + 1) * tile], per_col[k], out=hit[k * tile : (k + 1) * tile])
    flat = np.flatnonzero(hit)
    return np.divmod(flat, smooth.shape[1])


def _is_maximum(smooth: NDArray[Any], row: NDArray[np.intp], col: NDArray[np.intp]) -> NDArray[np.bool_]:
    """No neighbour is higher; of equal ones the first in reading order counts."""
    rows, cols = smooth.shape
    here = smooth[row, col]
    best = np.ones(len(row), bool)
    for dr, dc in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
        there = smooth[np.clip(row + dr, 0, rows - 1), np.clip(col + dc, 0, cols - 1)]
        outside = (row + dr < 0) | (row + dr >= rows) | (col + dc < 0) | (col + dc >= cols)
        earlier = (dr, dc) < (0, 0)
        best &= outside | ((here > there) if earlier else (here >= there))
    return best


def _is_single_pixel(
    image: NDArray[Any],
    row: NDArray[np.intp],
    col: NDArray[np.intp],
    sky: Array,
    noise: Array,
    covariance: Array,
) -> NDArray[np.bool_]:
    """Light that stands in one pixel, one row or one column only: a hot pixel, cosmic ray or column defect, no lens makes it.

    A star of covariance C leaves its four neighbours at exp(−1/2C) of the peak in the worst case of a centred star;
    about a third of that is asked for, along columns and along rows separately, within the noise.
    """
    rows, cols = image.shape
    side = np.arange(-1, 2)
    r = np.clip(row[:, None, None] + side[:, None], 0, rows - 1)
    c = np.clip(col[:, None, None] + side, 0, cols - 1)
    box = image[r, c].astype(float) - sky[:, None, None]
    # The raw maximum may sit next to the filtered one.
    k = box.reshape(len(row), 9).argmax(1) if len(row) else np.zeros(0, int)
    r2, c2 = row + k // 3 - 1, col + k % 3 - 1
    r = np.clip(r2[:, None, None] + side[:, None], 0, rows - 1)
    c = np.clip(c2[:, None, None] + side, 0, cols - 1)
    box = image[r, c].astype(float) - sky[:, None, None]
    peak = box[:, 1, 1]
    across, along = box[:, 1, [0, 2]].sum(1), box[:, [0, 2], 1].sum(1)
    expected_col = 2 * np.exp(-0.5 / max(covariance[0, 0], 0.25))
    expected_row = 2 * np.exp(-0.5 / max(covariance[1, 1], 0.25))
    doubt = 1.5 * noise
    return np.asarray(
        (across + doubt < SINGLE_SHARE * expected_col * peak) | (along + doubt < SINGLE_SHARE * expected_row * peak)
    )

"""Candidate stars: local maxima of the frame under a matched filter, with single bright pixels flagged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from gss.domain.angles import Array
from gss.pipeline.background import Background, measure_background, pixel_noise
from gss.pipeline.kernels import NUMPY, Kernels
from gss.pipeline.psf import cut_stamps, widths_px
from gss.pipeline.small import median

MAX_PEAKS = 4000  # limits the computing time; if there are more peaks, the faintest are omitted and a note states this
STREAK_RATIO = 1.7
BINOMIAL_GAIN = 256.0
BINOMIAL = np.array([1.0, 4.0, 6.0, 4.0, 1.0])
STRIP_ROWS = 128
# Neighbours of a pixel, (row, column), in reading order: four before it, four after.
AROUND = np.array([(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)])
SINGLE_SHARE = 0.35  # minimum light of a real star's neighbour pixels, as a share of that of a centred star
SINGLE_DOUBT_SIGMA = 1.5
NARROWEST_PX2 = 0.25


def _binomial_sum(image: NDArray[Any]) -> NDArray[Any]:
    """Sum 5x5 pixels with binomial weights (gain 256, sigma 1 px), in 16 bits for 8-bit frames. Edge pixels are repeated.

    The frame is processed in strips that fit the processor's cache; summing neighbours four times along each axis gives the
    weights 1 4 6 4 1.
    """
    kind = np.uint16 if image.dtype == np.uint8 else np.float32
    rows, cols = image.shape
    out = np.empty((rows, cols), kind)
    size = (min(rows, STRIP_ROWS) + 4) * (cols + 4)
    buffer, spare = np.empty(size, kind), np.empty(size, kind)
    for top in range(0, rows, STRIP_ROWS):
        bottom = min(top + STRIP_ROWS, rows)
        high, width = bottom - top + 4, cols + 4
        first, last = max(top - 2, 0), min(bottom + 2, rows)
        wide = buffer[: high * width].reshape(high, width)
        skip = first - (top - 2)
        wide[skip : skip + last - first, 2:-2] = image[first:last]
        wide[:skip, 2:-2], wide[skip + last - first :, 2:-2] = image[0], image[-1]
        wide[:, :2], wide[:, -2:] = wide[:, 2:3], wide[:, -3:-2]
        # The strip is treated as a flat array: adding the next element or the element one row below needs no copies, and
        # values that wrap over the end of a row are never read.
        a, b = buffer[: high * width], spare[: high * width]
        length = high * width
        for reach in (1, 1, 1, 1, width, width, width):
            np.add(a[: length - reach], a[reach:length], out=b[: length - reach])
            length -= reach
            a, b = b, a
        summed = a.reshape(high, width)[: bottom - top + 1, :cols]
        np.add(summed[:-1], summed[1:], out=out[top:bottom])
    return out


def _filter_frame(
    image: NDArray[Any], covariance: Array, loops: Kernels = NUMPY
) -> tuple[NDArray[Any], float, tuple[Array, Array]]:
    """Filter the frame with a kernel close to its point-spread function. Returns the filtered frame, the filter's gain,
    and the noise near its edges along rows and columns, see :func:`_edge_noise`. The noise in the interior must be measured
    on the filtered frame."""
    low, high = widths_px(covariance)
    if high < 1.6:
        smooth = (_binomial_sum if loops.frames is None else loops.frames.binomial)(image)
        return smooth, BINOMIAL_GAIN, (BINOMIAL_EDGE, BINOMIAL_EDGE)
    if high / low < STREAK_RATIO:
        sigma = float(np.sqrt(low * high))
        smooth = ndimage.gaussian_filter(image.astype(np.float32), sigma, mode="nearest")
        reach = np.arange(-int(4 * sigma + 0.5), int(4 * sigma + 0.5) + 1)
        line = np.exp(-0.5 * (reach / sigma) ** 2)
        return np.asarray(smooth), 1.0, (_edge_noise(line), _edge_noise(line))
    half = int(np.ceil(2.5 * high))
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    q = np.linalg.inv(covariance)
    kernel = np.exp(-0.5 * (q[0, 0] * x * x + 2 * q[0, 1] * x * y + q[1, 1] * y * y))
    smooth = _convolved(np.pad(image, half, mode="edge"), kernel / kernel.sum())
    return smooth, 1.0, (_edge_noise(kernel.sum(1)), _edge_noise(kernel.sum(0)))


def _convolved(image: NDArray[Any], kernel: Array) -> NDArray[np.float32]:
    """Return the convolution where the (k, m) kernel is completely inside the (rows, columns) image. scipy.signal needs 1.2 to 2
    times as long, and its import takes 35 MB of memory."""
    # The transform spreads the rounding error of an absurdly bright pixel over the frame. Only frames of floating-point
    # numbers can contain such a pixel.
    precision = np.float64 if image.dtype.kind == "f" else np.float32
    image, kernel = image.astype(precision), kernel.astype(precision)
    shape = [fft.next_fast_len(side, real=True) for side in image.shape]
    # The transform repeats the image at its edges, which affects only the places that are not returned.
    repeated = fft.irfft2(fft.rfft2(image, shape) * fft.rfft2(kernel, shape), shape)
    rows, columns = kernel.shape
    inside = repeated[rows - 1 : image.shape[0], columns - 1 : image.shape[1]]
    return np.ascontiguousarray(inside, np.float32)


def _edge_noise(line: Array) -> Array:
    """Return the (half the kernel + 1,) ratios of the filtered frame's noise to its noise in the interior, by the distance
    from the edge. The ratio exceeds 1 near the edges, because the outermost pixel is repeated and its noise does not
    average out."""
    half = len(line) // 2
    weights = np.zeros((half, len(line)))
    for distance in range(half):
        np.add.at(weights[distance], np.maximum(np.arange(-half, half + 1) + distance, 0), line)
    return np.append(np.sqrt((weights**2).sum(1) / (line**2).sum()), 1.0)


BINOMIAL_EDGE = _edge_noise(BINOMIAL)


@dataclass(frozen=True)
class Peaks:
    """Local maxima of the filtered frame, most significant first: position, signal-to-noise ratio, sky level and noise of a raw
    pixel, and ``single`` for single bright pixels. ``background``: mesh of the raw frame."""

    col: NDArray[np.intp]
    row: NDArray[np.intp]
    snr: Array
    sky: Array
    noise: Array
    single: NDArray[np.bool_]
    background: Background


def find_peaks(
    image: NDArray[Any], covariance: Array, threshold_sigma: float, notes: list[str], loops: Kernels = NUMPY
) -> Peaks:
    """Find the local maxima of a (rows, cols) frame that exceed ``threshold_sigma`` after filtering with the width of its stars."""
    smooth, gain, (down, across) = _filter_frame(image, covariance, loops)
    background = measure_background(smooth, loops=loops)
    raw_background = _unfiltered(image, background, gain, loops)
    find = _significant if loops.frames is None else loops.frames.significant
    row, col, snr = find(smooth, background, threshold_sigma, down, across)
    if len(row) > MAX_PEAKS:
        notes.append(f"{len(row)} peaks above threshold; only the brightest {MAX_PEAKS} are examined")
        row, col, snr = row[:MAX_PEAKS], col[:MAX_PEAKS], snr[:MAX_PEAKS]
    sky, raw_noise = (
        raw_background.at(col, row) if loops.frames is None else loops.frames.sky_of(raw_background, col, row)
    )
    single = _single_pixels(image, row, col, sky, raw_noise, covariance, loops)
    return Peaks(col, row, snr, sky, raw_noise, single, raw_background)


def _significant(
    smooth: NDArray[Any], background: Background, sigma: float, down: Array, across: Array
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return rows, columns and signal-to-noise ratios of the maxima above ``sigma``, most significant first. ``down``,
    ``across``: see :func:`_edge_noise`."""
    row, col = _maxima(smooth, background, sigma)
    level, noise = background.at(col, row)
    for position, count, ratio in ((row, smooth.shape[0], down), (col, smooth.shape[1], across)):
        noise = noise * ratio[np.minimum(np.minimum(position, count - 1 - position), len(ratio) - 1)]
    snr = (smooth[row, col] - level) / noise
    keep = np.flatnonzero(snr > sigma)
    keep = keep[np.argsort(-snr[keep], kind="stable")]
    return row[keep], col[keep], snr[keep]


def _unfiltered(image: NDArray[Any], background: Background, gain: float, loops: Kernels) -> Background:
    """Convert the mesh of a filtered frame to level and noise of single pixels; ``gain``: gain of the filter on a flat
    frame."""
    level = background.scaled(1 / gain, 1.0)
    return level.scaled(1.0, pixel_noise(image, level, loops=loops) / median(background.noise.ravel()))


def repeat_single_test(image: NDArray[Any], peaks: Peaks, covariance: Array, loops: Kernels = NUMPY) -> Peaks:
    """Repeat the single-pixel test with the frame's measured point-spread function."""
    single = _single_pixels(image, peaks.row, peaks.col, peaks.sky, peaks.noise, covariance, loops)
    return replace(peaks, single=single)


def _maxima(smooth: NDArray[Any], background: Background, sigma: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the local maxima above the lowest threshold of their tile. Some of them can be below
    the threshold at their own position."""
    tile = background.tile_px
    lowest = background.lowest_threshold(sigma)
    if smooth.dtype.kind == "u":
        lowest = np.clip(np.floor(lowest), 0, np.iinfo(smooth.dtype).max)
    per_col = np.repeat(lowest.astype(smooth.dtype), tile, axis=1)[:, : smooth.shape[1]]
    hit = np.empty(smooth.shape, bool)
    for k in range(len(lowest)):
        np.greater(smooth[k * tile : (k + 1) * tile], per_col[k], out=hit[k * tile : (k + 1) * tile])
    row, col = np.divmod(np.flatnonzero(hit), smooth.shape[1])
    top = _is_maximum(smooth, row, col)
    return row[top], col[top]


def _is_maximum(smooth: NDArray[Any], row: NDArray[np.intp], col: NDArray[np.intp]) -> NDArray[np.bool_]:
    """True for pixels without a brighter neighbour. If neighbours are equally bright, only the first in reading order
    is a maximum."""
    rows, cols = smooth.shape
    r, c = row + AROUND[:, :1], col + AROUND[:, 1:]
    outside = (r < 0) | (r >= rows) | (c < 0) | (c >= cols)
    neighbours = smooth.ravel()[np.where(outside, 0, r * cols + c)]
    centre = smooth[row, col]
    best = np.concatenate([centre > neighbours[:4], centre >= neighbours[4:]]) | outside
    return np.asarray(best.all(axis=0))


def _single_pixels(
    image: NDArray[Any],
    row: NDArray[np.intp],
    col: NDArray[np.intp],
    sky: Array,
    noise: Array,
    covariance: Array,
    loops: Kernels,
) -> NDArray[np.bool_]:
    test = _is_single_pixel if loops.frames is None else loops.frames.single_pixels
    return test(image, row, col, sky, noise, covariance)


def _is_single_pixel(
    image: NDArray[Any],
    row: NDArray[np.intp],
    col: NDArray[np.intp],
    sky: Array,
    noise: Array,
    covariance: Array,
) -> NDArray[np.bool_]:
    """True for peaks confined to one pixel, row or column: a hot pixel, cosmic ray or column defect.

    The neighbours are faintest for a centred star. Its four neighbours then have exp(−1/2C) of the peak for the
    covariance C. About a third of this light is required within the noise, separately along columns and along rows.
    """
    # The maximum of the raw frame can be next to the maximum of the filtered frame.
    k = cut_stamps(image, col, row, sky, 1, np.inf).value.argmax(1)
    box = cut_stamps(image, col + k % 3 - 1, row + k // 3 - 1, sky, 1, np.inf).value
    peak = box[:, 4]
    across, along = box[:, 3] + box[:, 5], box[:, 1] + box[:, 7]
    expected_col = 2 * np.exp(-0.5 / max(covariance[0, 0], NARROWEST_PX2))
    expected_row = 2 * np.exp(-0.5 / max(covariance[1, 1], NARROWEST_PX2))
    doubt = SINGLE_DOUBT_SIGMA * noise
    return np.asarray(
        (across + doubt < SINGLE_SHARE * expected_col * peak) | (along + doubt < SINGLE_SHARE * expected_row * peak)
    )

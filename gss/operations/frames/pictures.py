"""Images for display: stretch, PNG, thumbnails, histograms."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Pixels = NDArray[np.generic]
THUMBNAIL_PX = 144
HISTOGRAM_BINS = 256
FULL_SCALES = frozenset(2.0**bits - 1 for bits in (8, 10, 12, 14, 16))
"""Largest values of converters."""


@dataclass(frozen=True)
class DisplayRange:
    """Display range from ``low`` (black) to ``high`` (white). ``asinh``: True for an arcsinh scale, which shows faint and bright
    details; False for a linear scale."""

    low: float
    high: float
    asinh: bool = True


def auto_stretch(pixels: Pixels) -> DisplayRange:
    """Return a display range with black slightly below the sky level and white at the brightest 0.02 % of the pixels. A
    saturated image is white."""
    sample = np.asarray(pixels[::4, ::4], float)
    sample = sample[np.isfinite(sample)]
    if not sample.size:
        return DisplayRange(0.0, 1.0)
    sky, spread = float(np.median(sample)), float(np.subtract(*np.percentile(sample, [84, 16])) / 2)
    if _saturated(sample):
        return DisplayRange(0.0, sky)
    low = sky - 0.5 * max(spread, 0.5)
    min_range = 10 * max(
        spread, 1.0, abs(sky) * 1e-6
    )  # the last term avoids a range below the precision of large values
    high = max(float(np.percentile(np.asarray(pixels, float), 99.98)), low + min_range)
    return DisplayRange(low, high)


def apply(pixels: Pixels, stretch: DisplayRange, *, invert: bool = False) -> NDArray[np.uint8]:
    """Return the pixels as an 8-bit image of the same shape. ``invert``: True for dark stars on a bright background."""
    span = max(stretch.high - stretch.low, 1e-9)
    x = np.clip((np.nan_to_num(np.asarray(pixels, np.float32)) - stretch.low) / span, 0, 1)
    if stretch.asinh:
        x = np.arcsinh(10 * x) / np.float32(np.arcsinh(10))
    grey = (x * 255 + 0.5).astype(np.uint8)
    return np.asarray(255 - grey if invert else grey)


def png(grey: NDArray[np.uint8] | NDArray[np.uint16], level: int = 1) -> bytes:
    """Return an 8-bit or 16-bit image as a PNG file. ``level``: compression level (1: fast, 9: small)."""
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, format="PNG", compress_level=level)
    return buffer.getvalue()


def thumbnail(pixels: Pixels) -> bytes:
    """Return a small PNG that shows the stars. Each block of pixels is reduced to its maximum. Values that
    noise alone can cause in a block are black. The brightest 0.2 % of the blocks are white, and a saturated image is
    white."""
    factor = max(1, -(-max(pixels.shape) // THUMBNAIL_PX))
    rows, cols = (n // factor * factor for n in pixels.shape)
    if rows == 0 or cols == 0:
        return png(apply(pixels, auto_stretch(pixels)))
    blocks = np.asarray(pixels[:rows, :cols]).reshape(rows // factor, factor, cols // factor, factor)
    small = np.nan_to_num(np.asarray(blocks.max(axis=(1, 3)), float))
    if _saturated(small):
        return png(apply(small, DisplayRange(0.0, float(small.max()))))
    quartiles = np.percentile(small, [25, 50, 99.8])
    spread = max(float(quartiles[1] - quartiles[0]), 0.5)
    low = float(quartiles[1]) + 2 * spread
    return png(apply(small, DisplayRange(low, max(float(quartiles[2]), low + 10 * spread))))


def _saturated(values: NDArray[np.float64]) -> bool:
    """Return True if at least half of the values are the largest value of a converter."""
    largest = float(values.max())
    return largest in FULL_SCALES and float(np.median(values)) == largest


def histogram(pixels: Pixels) -> tuple[list[float], list[int]]:
    """Return a histogram as (edges, counts) over the range of finite values."""
    values = np.asarray(pixels).ravel()
    values = values[np.isfinite(values)] if values.dtype.kind == "f" else values
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    counts, edges = np.histogram(
        values.astype(float), bins=HISTOGRAM_BINS, range=(low, max(high, low + 1, low + abs(low) * 1e-6))
    )
    return [float(e) for e in edges], [int(c) for c in counts]

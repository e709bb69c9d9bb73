"""Images for display: stretch, PNG, thumbnails, histograms."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

if TYPE_CHECKING:
    from gss.store.models import Frame

Pixels = NDArray[np.generic]
THUMBNAIL_PX = 144
HISTOGRAM_BINS = 256
WHOLE_BYTES = (16, 32)
"""Numbers of bits of imported files that can contain values of a converter with fewer bits."""


@dataclass(frozen=True)
class DisplayRange:
    """Display range from ``low`` (black) to ``high`` (white). ``asinh``: True for an arcsinh scale, which shows faint and bright
    details; False for a linear scale."""

    low: float
    high: float
    asinh: bool = True


def full_scale_dn(frame: Frame) -> float | None:
    """Return the largest value of the converter; None if the file of an imported frame does not determine it."""
    return None if frame.source == "import" and frame.bits in WHOLE_BYTES else 2.0**frame.bits - 1


def auto_stretch(pixels: Pixels, full_dn: float | None) -> DisplayRange:
    """Return a display range with black slightly below the sky level and white at the brightest 0.02 % of the pixels.

    ``full_dn``: largest value of the converter, None if unknown. An image with at least half of the pixels at this value
    is white. If it is unknown, an image with at least half of the pixels at its own maximum is grey, because it can be
    saturated.
    """
    sample = np.asarray(pixels[::4, ::4], float)
    sample = sample[np.isfinite(sample)]
    if not sample.size:
        return DisplayRange(0.0, 1.0)
    sky, spread = float(np.median(sample)), float(np.subtract(*np.percentile(sample, [84, 16])) / 2)
    if (clipped := _clipped_range(sample, full_dn)) is not None:
        return clipped
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


def thumbnail(pixels: Pixels, full_dn: float | None) -> bytes:
    """Return a small PNG that shows the stars. Each block of pixels is reduced to its maximum. Values that
    noise alone can cause in a block are black. The brightest 0.2 % of the blocks are white. ``full_dn``, and images with
    most pixels at one maximum: as in ``auto_stretch``."""
    factor = max(1, -(-max(pixels.shape) // THUMBNAIL_PX))
    rows, cols = (n // factor * factor for n in pixels.shape)
    if rows == 0 or cols == 0:
        return png(apply(pixels, auto_stretch(pixels, full_dn)))
    blocks = np.asarray(pixels[:rows, :cols]).reshape(rows // factor, factor, cols // factor, factor)
    small = np.nan_to_num(np.asarray(blocks.max(axis=(1, 3)), float))
    if (clipped := _clipped_range(small, full_dn)) is not None:
        return png(apply(small, clipped))
    quartiles = np.percentile(small, [25, 50, 99.8])
    spread = max(float(quartiles[1] - quartiles[0]), 0.5)
    low = float(quartiles[1]) + 2 * spread
    return png(apply(small, DisplayRange(low, max(float(quartiles[2]), low + 10 * spread))))


def _clipped_range(values: NDArray[np.float64], full_dn: float | None) -> DisplayRange | None:
    """Return the display range of an image with at least half of the values at its maximum: this maximum is white if it is
    ``full_dn``, and grey if ``full_dn`` is unknown. None for other images."""
    largest = float(values.max())
    if largest <= 0 or float(np.median(values)) != largest or full_dn not in (None, largest):
        return None
    return DisplayRange(0.0, largest if full_dn else 2 * largest)


def histogram(pixels: Pixels) -> tuple[list[float], list[int]]:
    """Return a histogram as (edges, counts) over the range of finite values."""
    values = np.asarray(pixels).ravel()
    values = values[np.isfinite(values)] if values.dtype.kind == "f" else values
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    counts, edges = np.histogram(
        values.astype(float), bins=HISTOGRAM_BINS, range=(low, max(high, low + 1, low + abs(low) * 1e-6))
    )
    return [float(e) for e in edges], [int(c) for c in counts]

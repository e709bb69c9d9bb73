"""Dark-frame correction: subtract the fixed pattern and replace bad pixels.

The dark pattern is used for frames that are processed on the ground (Huffman 2006 §4.1). Chains that replicate an
on-board sensor use only the bad pixels of its table (Moniteq 1983 §4.3: a table of defective pixels, which are ignored).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gss.domain.errors import BadInput

SAME_EXPOSURE = 0.2
"""Largest relative difference between two exposures up to which the pattern is subtracted. The pattern is mostly dark
current, which depends on the exposure."""
Frame = TypeVar("Frame", bound=NDArray[Any])
NEIGHBOURS = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0)]


@dataclass(frozen=True)
class DarkPattern:
    """Fixed pattern of a detector. ``pattern_dn``: (rows, columns) dark level of each pixel above the typical one.
    ``bad``: (k, 2) col, row of hot, noisy or dead pixels. ``exposure_s``: exposure of the dark frames."""

    pattern_dn: NDArray[np.float32]
    bad: NDArray[np.intp]
    exposure_s: float

    def fits(self, exposure_s: float | None) -> bool:
        """True if the frame's exposure is close enough to that of the dark frames, or unknown (None)."""
        return exposure_s is None or abs(exposure_s - self.exposure_s) <= SAME_EXPOSURE * self.exposure_s


def clean(
    pixels: NDArray[np.generic], pattern: DarkPattern, saturation_dn: float, exposure_s: float | None = None
) -> NDArray[np.float32]:
    """Subtract the pattern (if the exposure fits) and replace bad pixels by the median of their good neighbours.

    Returns (rows, columns) pixels. The pattern is not subtracted from saturated pixels, whose true value is unknown. Raises
    :class:`BadInput` if the frame and the dark frame differ in shape.
    """
    if pixels.shape != pattern.pattern_dn.shape:
        raise BadInput(
            "the dark frame does not fit this detector",
            expected=f"{pattern.pattern_dn.shape[1]} x {pattern.pattern_dn.shape[0]} px",
            got=f"{pixels.shape[1]} x {pixels.shape[0]} px",
        )
    raw = np.asarray(pixels, np.float32)
    out = raw - pattern.pattern_dn if pattern.fits(exposure_s) else raw.copy()
    out = np.where(raw >= saturation_dn, raw, out)
    return without_bad_pixels(out, pattern.bad)


def without_bad_pixels(image: Frame, bad: NDArray[np.intp]) -> Frame:
    """Return the (rows, columns) image with the (k, 2) bad pixels, col and row, replaced by the median of their good
    neighbours. In an image of integers the median is rounded down. A pixel without good neighbours is unchanged."""
    if not len(bad):
        return image
    is_bad = np.zeros(image.shape, bool)
    is_bad[bad[:, 1], bad[:, 0]] = True
    wide = np.pad(np.where(is_bad, np.float32(np.nan), image), 1, constant_values=np.nan)
    row, col = bad[:, 1] + 1, bad[:, 0] + 1
    around = np.stack([wide[row + y, col + x] for y, x in NEIGHBOURS])
    repairable = np.isfinite(around).any(axis=0)
    out = image.copy()
    out[bad[repairable, 1], bad[repairable, 0]] = np.nanmedian(around[:, repairable], axis=0)
    return out

"""What a detector shows in the dark, taken out of a frame: the fixed pattern, and pixels that cannot be believed.

Chains that stand for a sensor never see this: it is for frames that the ground works on itself (Huffman 2006 §4.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.errors import BadInput

SAME_EXPOSURE = 0.2
"""The pattern is mostly dark current: it is taken out of frames whose exposure is within this share of the dark frames'."""
NEIGHBOURS = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0)]


@dataclass(frozen=True)
class FixedPattern:
    """``pattern_dn``: (rows, columns) level of each pixel above the typical one in the dark. ``bad``: (k, 2) col, row of
    pixels that are hot, noisy or dead. ``exposure_s``: of the dark frames."""

    pattern_dn: NDArray[np.float32]
    bad: NDArray[np.intp]
    exposure_s: float

    def fits(self, exposure_s: float | None) -> bool:
        """Was the frame exposed as long as the dark frames, or nearly? An exposure that is not known is taken for theirs."""
        return exposure_s is None or abs(exposure_s - self.exposure_s) <= SAME_EXPOSURE * self.exposure_s


def clean(
    pixels: NDArray[np.generic], known: FixedPattern, saturation_dn: float, exposure_s: float | None = None
) -> NDArray[np.float32]:
    """(rows, columns) pixels without the pattern (where the exposure fits) and with bad pixels replaced by the median of their good
    neighbours. Saturated pixels stay as they are: what is lost cannot be told by a difference."""
    if pixels.shape != known.pattern_dn.shape:
        raise BadInput(
            "the dark frame is of another detector",
            expected=f"{known.pattern_dn.shape[1]} x {known.pattern_dn.shape[0]} px",
            got=f"{pixels.shape[1]} x {pixels.shape[0]} px",
        )
    raw = np.asarray(pixels, np.float32)
    out = raw - known.pattern_dn if known.fits(exposure_s) else raw.copy()
    out = np.where(raw >= saturation_dn, raw, out)
    return _mended(out, known.bad)


def _mended(image: NDArray[np.float32], bad: NDArray[np.intp]) -> NDArray[np.float32]:
    if not len(bad):
        return image
    broken = np.zeros(image.shape, bool)
    broken[bad[:, 1], bad[:, 0]] = True
    wide = np.pad(np.where(broken, np.nan, image), 1, constant_values=np.nan)
    row, col = bad[:, 1] + 1, bad[:, 0] + 1
    around = np.stack([wide[row + y, col + x] for y, x in NEIGHBOURS])
    has = np.isfinite(around).any(axis=0)
    out = image.copy()
    out[bad[has, 1], bad[has, 0]] = np.nanmedian(around[:, has], axis=0)
    return out

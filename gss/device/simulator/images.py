"""Image memories: a stored frame, its bytes on the link, its thumbnail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.dark_columns import NO_DARK_COLUMNS, DarkColumns
from gss.domain.results import Truth

SLOTS = 4
THUMBNAIL_BINNING = 4
Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class StoredFrame:
    """One image memory. ``time_s``: device time of mid-exposure. ``truth``: only for images of the simulated sky.
    ``dark``: (rows, n) pixels
    of the dark columns, None for an uploaded image or a detector without them."""

    number: int
    slot: int
    pixels: Pixels
    exposure_ms: int
    time_s: float
    source: str
    mode: str
    bits: int
    truth: Truth | None = None
    dark: Pixels | None = None
    dark_columns: DarkColumns = NO_DARK_COLUMNS

    @property
    def data(self) -> bytes:
        """Pixel bytes, rows from top to bottom with their dark columns; one byte per pixel up to eight bits, otherwise two,
        high byte first."""
        return frame_bytes(self.dark_columns.join(self.pixels, self.dark))


def frame_bytes(pixels: Pixels) -> bytes:
    """Return the pixel bytes in the order of the link."""
    return pixels.tobytes() if pixels.dtype == np.uint8 else pixels.astype(">u2").tobytes()


def thumbnail(pixels: Pixels) -> Pixels:
    """Return averages of 4x4 pixel blocks; incomplete blocks at the right and bottom edges are omitted."""
    n = THUMBNAIL_BINNING
    rows, columns = pixels.shape[0] // n * n, pixels.shape[1] // n * n
    blocks = pixels[:rows, :columns].reshape(rows // n, n, columns // n, n)
    mean = np.asarray(np.rint(blocks.mean(axis=(1, 3))))
    return mean.astype(np.uint8) if pixels.dtype == np.uint8 else mean.astype(np.uint16)

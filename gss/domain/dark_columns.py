"""Dark columns of a detector: columns that are shielded from light and are read out with every row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class DarkColumns:
    """Numbers of dark columns that are read out before (``left``) and after (``right``) the light-sensitive columns of a
    row. Pixel coordinates refer to the light-sensitive columns."""

    left: int = 0
    right: int = 0

    @property
    def count(self) -> int:
        """Number of dark columns."""
        return self.left + self.right

    def split(self, picture: NDArray[Any], columns: int) -> tuple[NDArray[Any], NDArray[Any] | None]:
        """Split (rows, n) complete rows into the (rows, columns) light-sensitive pixels and the (rows, count) dark pixels.
        A picture of another width has no dark columns: it is returned unchanged, with None."""
        if not self.count or picture.ndim != 2 or picture.shape[1] != columns + self.count:
            return picture, None
        end = self.left + columns
        return picture[:, self.left : end], np.concatenate([picture[:, : self.left], picture[:, end:]], axis=1)

    def join(self, pixels: NDArray[Any], dark: NDArray[Any] | None) -> NDArray[Any]:
        """Return the complete rows in the order of the read-out; inverse of :meth:`split`."""
        if dark is None:
            return pixels
        return np.concatenate([dark[:, : self.left], pixels, dark[:, self.left :]], axis=1)


NO_DARK_COLUMNS = DarkColumns()

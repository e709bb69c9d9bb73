"""Star tables."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput

Ids = NDArray[np.int32]
GAIA_FIRST = 1_000_000
"""Offset of the numbers of stars that only Gaia contains. The number of such a star is the offset plus its row in the
packaged Gaia file. Hipparcos numbers end at 120 404."""


@dataclass(frozen=True)
class StarTable:
    """n stars at one epoch. All arrays have n rows, in any order.

    ``icrs``: (n, 3) unit vectors. ``proper_motion_rad_yr``: (n, 3) velocities of these vectors, tangent to the sphere.
    ``v_mag``: Johnson V. ``b_v``: colour index, NaN if unknown. ``flags``: bitwise OR of the FLAG_ constants.
    ``hip_numbers``: False if ``hip`` contains the numbers of another list or of rows.
    """

    hip: Ids
    icrs: Array
    v_mag: Array
    b_v: Array
    proper_motion_rad_yr: Array
    parallax_rad: Array
    flags: NDArray[np.uint16]
    epoch_jyear: float
    names: dict[int, str] = field(default_factory=dict, repr=False)
    hip_numbers: bool = True

    def __post_init__(self) -> None:
        n = len(self.hip)
        shapes = {
            "icrs": (n, 3),
            "v_mag": (n,),
            "b_v": (n,),
            "proper_motion_rad_yr": (n, 3),
            "parallax_rad": (n,),
            "flags": (n,),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise BadInput(
                    f"star table column {name} has the wrong shape",
                    expected=str(shape),
                    got=str(getattr(self, name).shape),
                )

    def __len__(self) -> int:
        return len(self.hip)

    def take(self, index: NDArray[np.bool_] | NDArray[np.intp]) -> StarTable:
        """Return the rows selected by a boolean mask or an index array, in that order."""
        columns = ("hip", "icrs", "v_mag", "b_v", "proper_motion_rad_yr", "parallax_rad", "flags")
        return replace(self, **{name: getattr(self, name)[index] for name in columns})

    def brighter_than(self, v_mag: float) -> StarTable:
        """Return the stars with V ≤ ``v_mag``, brightest first."""
        index = np.flatnonzero(self.v_mag <= v_mag)
        return self.take(index[np.argsort(self.v_mag[index], kind="stable")])

    @cached_property
    def row_of_hip(self) -> dict[int, int]:
        """Hipparcos number to row."""
        return {int(hip): row for row, hip in enumerate(self.hip)}

    def rows_of(self, hip: Ids) -> NDArray[np.intp]:
        """Return the rows of n stars, -1 for a number that is not in the table."""
        order, ordered = self._by_hip
        if not len(order):
            return np.full(len(hip), -1)
        rows = order[np.minimum(np.searchsorted(ordered, hip), len(order) - 1)]
        return np.where(self.hip[rows] == hip, rows, -1)

    @cached_property
    def _by_hip(self) -> tuple[NDArray[np.intp], Ids]:
        """Return the rows in ascending order of the numbers, and these numbers."""
        order = np.argsort(self.hip, kind="stable")
        return order, self.hip[order]

    def name_of(self, hip: int) -> str:
        """Return the proper or Bayer name if the star has one; otherwise "HIP n", or "Gaia row n" for a star not in
        Hipparcos."""
        number = int(hip)
        return self.names.get(number, f"HIP {number}" if number < GAIA_FIRST else f"Gaia row {number - GAIA_FIRST}")


FLAG_VARIABLE = 1
FLAG_MULTIPLE = 2
FLAG_NO_PROPER_MOTION = 4
FLAG_POOR_POSITION = 8

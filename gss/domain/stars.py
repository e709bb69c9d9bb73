"""Stars of a catalogue, and the parts of it that a sensor carries."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.bank_tables import NO_TABLES, BankTables
from gss.domain.errors import BadInput

Ids = NDArray[np.int32]
# Hipparcos numbers end at 120 404. Stars that only Gaia has are numbered from here on, by row of the package's file.
GAIA_FIRST = 1_000_000


@dataclass(frozen=True)
class StarTable:
    """n stars at one epoch. All arrays have n rows, in any order.

    ``icrs``: (n, 3) unit vectors. ``proper_motion_rad_yr``: (n, 3) velocity of that vector, tangent to the sphere.
    ``v_mag``: Johnson V. ``b_v``: colour index, NaN where unknown. ``flags``: bit set of the FLAG_ constants.
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
        """The rows of a boolean mask or of an index array, in that order."""
        columns = ("hip", "icrs", "v_mag", "b_v", "proper_motion_rad_yr", "parallax_rad", "flags")
        return replace(self, **{name: getattr(self, name)[index] for name in columns})

    def brighter_than(self, v_mag: float) -> StarTable:
        """The stars with V ≤ ``v_mag``, brightest first."""
        index = np.flatnonzero(self.v_mag <= v_mag)
        return self.take(index[np.argsort(self.v_mag[index], kind="stable")])

    @cached_property
    def row_of_hip(self) -> dict[int, int]:
        """Row of each Hipparcos number."""
        return {int(hip): row for row, hip in enumerate(self.hip)}

    def name_of(self, hip: int) -> str:
        """Proper or Bayer name where there is one, else "HIP n", or the row in the Gaia file for stars that are not Hipparcos's."""
        number = int(hip)
        return self.names.get(number, f"HIP {number}" if number < GAIA_FIRST else f"Gaia row {number - GAIA_FIRST}")


FLAG_VARIABLE = 1
FLAG_MULTIPLE = 2
FLAG_NO_PROPER_MOTION = 4
FLAG_POOR_POSITION = 8


@dataclass(frozen=True)
class DistanceTable:
    """Pairs of stars sorted by angular distance.

    ``first`` < ``second`` are row numbers of the star list it belongs to; ``distance_rad`` ascends. float32 where the
    table came from a device, so that replay compares like with like.
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    distance_rad: NDArray[np.floating]
    min_rad: float
    max_rad: float

    def __len__(self) -> int:
        return len(self.distance_rad)


@dataclass(frozen=True)
class OnboardCatalogue:
    """What one flash bank holds, decoded: the matcher's whole world.

    ``hip``: (n,) catalogue numbers by row (ground knowledge; formats that carry only row ids get them from the manifest).
    ``icrs``: (n, 3) unit vectors at the width the device stores. ``v_mag``: (n,), NaN where the format has none.
    ``distances`` is empty where the format has other tables instead. ``tables``: what else the bank holds.
    """

    hip: Ids
    icrs: NDArray[np.floating]
    v_mag: NDArray[np.floating]
    distances: DistanceTable
    tables: BankTables = NO_TABLES

    def __len__(self) -> int:
        return len(self.hip)

    def need_distances(self) -> None:
        """BadInput where the bank's format has other tables in the place of distances."""
        if not len(self.distances) and (self.tables.links is not None or self.tables.constellations is not None):
            raise BadInput(
                "this chain matches by a distance table",
                expected="a bank with pairs of stars",
                got="a bank with triplets or links",
                hint="a catalogue in the format of the chain's own system",
            )

"""cubestar: tables of Erlank 2013 §5.3.2, four constant arrays of stars and three of pairs, as in the CubeStar
firmware.

14 bytes per star and 8 per pair: 405 stars take 5.54 KiB and 11 484 pairs 89.7 KiB. Star numbers are signed 16 bits
wide, so a list has at most 32 768 rows. The format has no magnitudes. The rows are in order of brightness if the
builder sorts them.
"""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.formats.blocks import BlockField, Columns, Rows
from gss.catalogue_tools.formats.header import BankHeader
from gss.catalogue_tools.formats.layout import BankFormat, Content
from gss.domain.errors import CorruptData
from gss.domain.stars import StarTable
from gss.skytables.pairs import DistanceTable

STARS = Rows(
    "stars",
    (
        BlockField("id", "<i2", "", "number of the row, from 0"),
        BlockField("x", "<f4", "", "ICRS unit vector"),
        BlockField("y", "<f4", "", "ICRS unit vector"),
        BlockField("z", "<f4", "", "ICRS unit vector"),
    ),
)
PAIRS = Rows(
    "pairs",
    (
        BlockField("first", "<i2", "", "row of the first star"),
        BlockField("second", "<i2", "", "row of the second star, higher than the first"),
        BlockField("distance_rad", "<f4", "rad", "angular distance, ascending"),
    ),
)


def write(stars: StarTable, distances: DistanceTable) -> tuple[Columns, Columns]:
    """Return the columns of both tables."""
    x, y, z = stars.icrs.T
    star_columns = {"id": np.arange(len(stars)), "x": x, "y": y, "z": z}
    return star_columns, {"first": distances.first, "second": distances.second, "distance_rad": distances.distance_rad}


def read(stars: Columns, pairs: Columns, header: BankHeader) -> Content:
    """Return the content of the columns. Raises CorruptData if the star numbers are not the row numbers."""
    n = header.stars
    if not np.array_equal(stars["id"], np.arange(n)):
        raise CorruptData(
            "the star numbers differ from the row numbers", expected=f"0 to {n - 1} in order", got="another list"
        )
    icrs = np.column_stack([stars["x"], stars["y"], stars["z"]]).astype(np.float32)
    return Content(icrs, np.full(n, np.nan, np.float32), distances_of(pairs, header))


def distances_of(pairs: Columns, header: BankHeader) -> DistanceTable:
    """Return the distance table of the columns first, second and distance_rad."""
    return DistanceTable(
        pairs["first"].astype(np.int32),
        pairs["second"].astype(np.int32),
        pairs["distance_rad"].astype(np.float32),
        header.min_rad,
        header.max_rad,
    )


FORMAT = BankFormat(
    name="cubestar",
    number=1,
    source="Erlank 2013 §5.3.2",
    stars=STARS,
    pairs=PAIRS,
    most_stars=1 << 15,
    largest_pair_rad=np.pi,
    write=write,
    read=read,
)

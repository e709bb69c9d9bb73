"""sunsat-5: Sunsat's star list with the small distance table of Jacobs 1995 app. D.1, which packs two star numbers and
a distance of 13 bits each into five bytes.

The document requires an accuracy of 50 µrad, which is 4 878 steps to 13.9°. A step is 50 µrad here, so the error of a
distance is at most 25 µrad (5.2″), 14 µrad rms. The limits are 8 192 stars, and 8 191 steps or 23.46° of distance. The
document does not state the order of the three numbers. Chosen: first star in bits 0 to 12, second in 13 to 25, distance
in 26 to 38 of a little-endian word of five bytes; bit 39 is zero. Pairs with equal steps keep the order of the true
distances.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.formats import sunsat
from gss.catalogue_tools.formats.blocks import BlockField, Columns, Rows
from gss.catalogue_tools.formats.header import BankHeader
from gss.catalogue_tools.formats.layout import BankFormat, Content, whole_numbers
from gss.domain.errors import CorruptData
from gss.domain.stars import StarTable
from gss.skytables.pairs import DistanceTable

STEP_RAD = 50e-6
BITS = 13
MAX_STEPS = (1 << BITS) - 1
PAIRS = Rows(
    "pairs",
    (
        BlockField("first", "u13", "", "row of the first star"),
        BlockField("second", "u13", "", "row of the second star, higher than the first"),
        BlockField("steps", "u13", "50 µrad", "angular distance, ascending"),
        BlockField("zero", "u1", "", "always 0"),
    ),
    bits=(BITS, BITS, BITS, 1),
)


def write(stars: StarTable, distances: DistanceTable) -> tuple[Columns, Columns]:
    """Return the columns of both tables. Raises BadInput if a distance is out of range."""
    steps = whole_numbers("a distance", distances.distance_rad, STEP_RAD, 0, MAX_STEPS)
    zero = np.zeros(len(distances), np.uint8)
    return sunsat.star_columns(stars), {
        "first": distances.first,
        "second": distances.second,
        "steps": steps,
        "zero": zero,
    }


def distances_rad(pairs: Columns) -> NDArray[np.float32]:
    """Return the (m,) distances at the middle of their steps."""
    return (pairs["steps"].astype(float) * STEP_RAD).astype(np.float32)


def read(stars: Columns, pairs: Columns, header: BankHeader) -> Content:
    """Return the content of the columns. Raises CorruptData if a spare bit is set."""
    if np.any(pairs["zero"]):
        raise CorruptData("the unused bit of a pair is set", expected="0", got="1")
    table = DistanceTable(
        pairs["first"].astype(np.int32),
        pairs["second"].astype(np.int32),
        distances_rad(pairs),
        header.min_rad,
        header.max_rad,
    )
    return sunsat.content_of(stars, table)


FORMAT = BankFormat(
    name="sunsat-5",
    number=3,
    source="Jacobs 1995 app. D.1",
    stars=sunsat.STARS,
    pairs=PAIRS,
    most_stars=1 << BITS,
    largest_pair_rad=(MAX_STEPS + 0.5) * STEP_RAD,
    write=write,
    read=read,
    ascending=distances_rad,
)

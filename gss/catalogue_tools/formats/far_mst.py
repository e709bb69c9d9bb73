"""far-mst: star list and pair directory of Huffman 2006 §5.5.4: two star numbers and sin²θ, ascending, with the
k-vector.

The document stores sin²θ, because then no arccosine is needed on board, and because sin²θ increases almost linearly
over the table. The document does not specify the bytes. Chosen: 14 bytes per star, 8 per pair, and the k-vector as a
section of 2 or 4 bytes per pair. The largest distance is 90°, because sin² is monotonic only up to this angle. If the
bank has a reduced catalogue, the directory covers the stars of that catalogue, and the whole list is used for
confirmation.
"""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.formats import vector_list
from gss.catalogue_tools.formats.blocks import BlockField, Columns, Rows
from gss.catalogue_tools.formats.header import BankHeader
from gss.catalogue_tools.formats.layout import BankFormat, Content, check_range
from gss.domain.stars import StarTable
from gss.skytables.bank import BankTables
from gss.skytables.pairs import DistanceTable

PAIRS = Rows(
    "pairs",
    (
        BlockField("first", "<u2", "", "row of the first star"),
        BlockField("second", "<u2", "", "row of the second star, higher than the first"),
        BlockField("sin2", "<f4", "", "sin² of the angular distance, ascending"),
    ),
)


def write(stars: StarTable, distances: DistanceTable) -> tuple[Columns, Columns]:
    """Return the columns of both tables."""
    sine = np.sin(distances.distance_rad.astype(float))
    pairs = {"first": distances.first, "second": distances.second, "sin2": (sine * sine).astype(np.float32)}
    return vector_list.star_columns(stars), pairs


def read(stars: Columns, pairs: Columns, header: BankHeader) -> Content:
    """Return the content of the columns. Distances are in double precision, so that encoding them gives the same
    sin²."""
    sin2 = pairs["sin2"].astype(np.float32)
    check_range("a sin²", sin2, 0.0, 1.0)
    table = DistanceTable(
        pairs["first"].astype(np.int32),
        pairs["second"].astype(np.int32),
        np.arcsin(np.sqrt(sin2.astype(float))),
        header.min_rad,
        header.max_rad,
    )
    return Content(vector_list.directions(stars), vector_list.magnitudes(stars), table, BankTables(sin2=sin2))


FORMAT = BankFormat(
    name="far-mst",
    number=4,
    source="Huffman 2006 §5.5.4",
    stars=vector_list.STARS,
    pairs=PAIRS,
    most_stars=1 << 16,
    largest_pair_rad=np.pi / 2,
    write=write,
    read=read,
    ascending=lambda pairs: pairs["sin2"],
    sections=("KVEC",),
)

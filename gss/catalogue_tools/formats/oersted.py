"""oersted: Liebe 1992, the star list and the data base of triplets, one section for each of its kinds of uncertainty.

The document's data base has 185 000 references in about 1 Mbyte and no bytes (chosen here). A reference is one of the classes
that a constellation of three stars may be measured in, so that about a dozen of them say the same; the bank keeps the
constellations, 8 bytes each, and the processor spreads them when it reads the bank. Sections: what the classes are; the
constellations of stars that are always seen; those where a neighbour may be missed or blends; those that an error of position
brings about. A bank without the last two still works, and finds fewer stars. No distance table: the chain has no use for one.
"""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.formats import vector_list
from gss.catalogue_tools.formats.blocks import Columns
from gss.catalogue_tools.formats.header import BankHeader
from gss.catalogue_tools.formats.layout import BankFormat, Content
from gss.domain.stars import DistanceTable, StarTable


def write(stars: StarTable, distances: DistanceTable) -> tuple[Columns, Columns]:
    """Columns of the star list."""
    return vector_list.star_columns(stars), {}


def read(stars: Columns, pairs: Columns, header: BankHeader) -> Content:
    """The catalogue of the columns."""
    return Content(vector_list.directions(stars), vector_list.magnitudes(stars), no_distances(header))


def no_distances(header: BankHeader) -> DistanceTable:
    """An empty table with the header's limits."""
    none = np.empty(0, np.int32)
    return DistanceTable(none, none, np.empty(0, np.float32), header.min_rad, header.max_rad)


FORMAT = BankFormat(
    name="oersted",
    number=5,
    source="Liebe 1992, 'Including uncertainty in the database'",
    stars=vector_list.STARS,
    pairs=None,
    most_stars=1 << 16,
    largest_pair_rad=np.pi,
    has_magnitudes=True,
    write=write,
    read=read,
    sections=("TCLS", "TCER", "TMAY", "TEXC"),
)

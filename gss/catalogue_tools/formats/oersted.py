"""oersted: star list and triplet database of Liebe 1992, with one section for each kind of constellation.

The database in the paper has 185 000 references in about 1 Mbyte. The paper does not specify the byte layout, so it is
defined here. A reference is one combination of rounded features (two distances and an angle) that a constellation of
three stars can produce. Each constellation has about a dozen references. The bank stores only the constellations, 8
bytes each, and the sensor derives the references when it reads the bank.

The section TCLS contains the class widths and limits of the database. TCER contains constellations of stars that are
always detected, TMAY constellations with a neighbour that may be missed or blended, and TEXC constellations that arise
only from a position error. A bank without TMAY and TEXC also works, but fewer stars are identified. There is no distance
table, because the chain does not use one.
"""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.formats import vector_list
from gss.catalogue_tools.formats.blocks import Columns
from gss.catalogue_tools.formats.header import BankHeader
from gss.catalogue_tools.formats.layout import BankFormat, Content
from gss.domain.stars import StarTable
from gss.skytables.pairs import DistanceTable


def write(stars: StarTable, distances: DistanceTable) -> tuple[Columns, Columns]:
    """Return the columns of the star list."""
    return vector_list.star_columns(stars), {}


def read(stars: Columns, pairs: Columns, header: BankHeader) -> Content:
    """Return the catalogue content that the columns store."""
    return Content(vector_list.directions(stars), vector_list.magnitudes(stars), no_distances(header))


def no_distances(header: BankHeader) -> DistanceTable:
    """Return an empty distance table with the angular limits of the header."""
    no_rows = np.empty(0, np.int32)
    return DistanceTable(no_rows, no_rows, np.empty(0, np.float32), header.min_rad, header.max_rad)


FORMAT = BankFormat(
    name="oersted",
    number=5,
    source="Liebe 1992, 'Including uncertainty in the database'",
    stars=vector_list.STARS,
    pairs=None,
    most_stars=1 << 16,
    largest_pair_rad=np.pi,
    write=write,
    read=read,
    sections=("TCLS", "TCER", "TMAY", "TEXC"),
)

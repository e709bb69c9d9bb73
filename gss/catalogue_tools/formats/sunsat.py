"""sunsat: tables of Jacobs 1995 app. D.1 and G.4: REAL32 right ascension, declination and magnitude; pairs of two
cardinals and a REAL32.

12 bytes per star and 8 per pair: the document's 288 464 entries take 2.3 MB. Star numbers are 16 bits wide, so at most
65 536 rows.
"""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.formats.blocks import BlockField, Columns, Rows
from gss.catalogue_tools.formats.cubestar import distances_of
from gss.catalogue_tools.formats.header import BankHeader
from gss.catalogue_tools.formats.layout import BankFormat, Content, check_range
from gss.domain.angles import ra_dec_from_unit, unit_from_ra_dec
from gss.domain.stars import StarTable
from gss.skytables.pairs import DistanceTable

STARS = Rows(
    "stars",
    (
        BlockField("ra_rad", "<f4", "rad", "right ascension, ICRS, 0 to 2π"),
        BlockField("dec_rad", "<f4", "rad", "declination"),
        BlockField("v_mag", "<f4", "mag", "magnitude V, NaN if unknown"),
    ),
    records=True,
)
PAIRS = Rows(
    "pairs",
    (
        BlockField("first", "<u2", "", "row of the first star"),
        BlockField("second", "<u2", "", "row of the second star, higher than the first"),
        BlockField("distance_rad", "<f4", "rad", "angular distance, ascending"),
    ),
    records=True,
)
# The single-precision numbers nearest to 2π and π/2 are larger than 2π and π/2. A star at these angles would be decoded
# at the other end of the range.
FULL_TURN = np.float32(2 * np.pi)
POLE = np.nextafter(np.float32(np.pi / 2), np.float32(0))


def star_columns(stars: StarTable) -> Columns:
    """Return RA, Dec and V in single precision."""
    ra, dec = (angle.astype(np.float32) for angle in ra_dec_from_unit(stars.icrs))
    ra[ra >= FULL_TURN] = 0.0
    return {"ra_rad": ra, "dec_rad": np.clip(dec, -POLE, POLE), "v_mag": stars.v_mag}


def write(stars: StarTable, distances: DistanceTable) -> tuple[Columns, Columns]:
    """Return the columns of both tables."""
    pairs = {"first": distances.first, "second": distances.second, "distance_rad": distances.distance_rad}
    return star_columns(stars), pairs


def read(stars: Columns, pairs: Columns, header: BankHeader) -> Content:
    """Return the content of the columns."""
    return content_of(stars, distances_of(pairs, header))


def content_of(stars: Columns, distances: DistanceTable) -> Content:
    """Compute the directions from the angles in double precision. Raises CorruptData if an angle is out of range."""
    check_range("a right ascension", stars["ra_rad"], -np.pi, 2 * np.pi + 1e-6)
    check_range("a declination", stars["dec_rad"], -np.pi / 2 - 1e-6, np.pi / 2 + 1e-6)
    icrs = unit_from_ra_dec(stars["ra_rad"].astype(float), stars["dec_rad"].astype(float))
    return Content(icrs, stars["v_mag"].astype(np.float32), distances)


FORMAT = BankFormat(
    name="sunsat",
    number=2,
    source="Jacobs 1995 app. D.1, G.4",
    stars=STARS,
    pairs=PAIRS,
    most_stars=1 << 16,
    largest_pair_rad=np.pi,
    write=write,
    read=read,
)

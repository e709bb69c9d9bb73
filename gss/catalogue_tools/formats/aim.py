"""aim: star list and linked list of neighbours of Moniteq 1983 §6.1, with a count and a pointer per star and each link
at both ends.

The document stores 3 000 stars in 70 kbyte, including 36 kbyte of links, but does not specify the bytes of a star. The
11 bytes per star are chosen: right ascension and declination in units of 360°/2³² (0.0003″), magnitude in thousandths,
eight flags. Links are 16 bits wide instead of 12, so any processor can read them. There are 8n − 12 links, which need
16 bytes per star. Pointers of 16 bits limit the list to 10 924 stars. There is no distance table, because the chain
does not use one.
"""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.formats.blocks import BlockField, Columns, Rows
from gss.catalogue_tools.formats.header import BankHeader
from gss.catalogue_tools.formats.layout import BankFormat, Content, check_range, from_millimag, to_millimag
from gss.catalogue_tools.formats.oersted import no_distances
from gss.domain.angles import ra_dec_from_unit, unit_from_ra_dec
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable
from gss.skytables.bank import BankTables
from gss.skytables.pairs import DistanceTable

UNIT_RAD = 2 * np.pi / 2**32
POLE = 2**30
STARS = Rows(
    "stars",
    (
        BlockField("ra_turn32", "<u4", "turn/2³²", "right ascension, ICRS"),
        BlockField("dec_turn32", "<i4", "turn/2³²", "declination, −2³⁰ to 2³⁰"),
        BlockField("v_mmag", "<i2", "0.001 mag", "magnitude V, −32 768 if unknown"),
        BlockField("flags", "<u1", "", "1 variable, 2 multiple, 4 no proper motion, 8 poor position"),
    ),
)


def write(stars: StarTable, distances: DistanceTable) -> tuple[Columns, Columns]:
    """Return the columns of the star list. Raises BadInput if a star's flags do not fit eight bits."""
    ra, dec = ra_dec_from_unit(stars.icrs)
    if np.any(stars.flags > 255):
        raise BadInput("a star's flags do not fit eight bits", expected="at most 255", got=str(int(stars.flags.max())))
    columns: Columns = {
        "ra_turn32": np.rint(ra / UNIT_RAD).astype(np.int64) % 2**32,
        "dec_turn32": np.rint(dec / UNIT_RAD).astype(np.int64),
        "v_mmag": to_millimag(stars.v_mag),
        "flags": stars.flags,
    }
    return columns, {}


def read(stars: Columns, pairs: Columns, header: BankHeader) -> Content:
    """Return the content of the columns. Raises CorruptData if a value is out of range."""
    dec = stars["dec_turn32"]
    check_range("a declination", dec, -POLE, POLE)
    icrs = unit_from_ra_dec(stars["ra_turn32"].astype(float) * UNIT_RAD, dec.astype(float) * UNIT_RAD)
    flags = stars["flags"].astype(np.uint8)
    return Content(icrs, from_millimag(stars["v_mmag"]), no_distances(header), BankTables(flags=flags))


FORMAT = BankFormat(
    name="aim",
    number=6,
    source="Moniteq 1983 §6.1",
    stars=STARS,
    pairs=None,
    most_stars=((1 << 16) - 1 + 12) // 6,
    largest_pair_rad=np.pi,
    write=write,
    read=read,
    sections=("LINK",),
)

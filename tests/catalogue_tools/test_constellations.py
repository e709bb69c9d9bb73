"""The lines of the constellations connect the correct stars."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from astropy.coordinates import SkyCoord, get_constellation

from gss.catalogue_tools.sources.constellations import FAINTEST_JOINED_MAG, TABLE, figures
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import ra_dec_from_unit
from gss.domain.errors import CorruptData
from gss.domain.stars import StarTable

MAX_RAD = np.radians(35.0)
SHARED = {("Aur", "Elnath"), ("Peg", "Alpheratz")}
"""Stars across the border that complete a figure."""


@pytest.fixture(scope="module")
def bright() -> StarTable:
    """Stars of GSS's table that belong to lines of constellations."""
    return load_stars().brighter_than(FAINTEST_JOINED_MAG)


def test_every_designation_is_a_star_of_our_own_table(bright: StarTable) -> None:
    """At least forty constellations, and what Orion's belt joins is Orion's belt (HIP 26727, 26311, 25930)."""
    found = figures(bright)
    assert len(found) == len(TABLE.strip().splitlines()) >= 40
    assert (26727, 26311, 25930) in next(figure.lines for figure in found if figure.short == "Ori")


def test_every_star_lies_in_the_constellation_by_its_official_border(bright: StarTable) -> None:
    """Independent check with the borders of 1930 from astropy; two stars belong to a neighbouring constellation."""
    found = figures(bright)
    ours = [(figure.short, hip) for figure in found for line in figure.lines for hip in line]
    rows = [bright.row_of_hip[hip] for _, hip in ours]
    ra_rad, dec_rad = ra_dec_from_unit(bright.icrs[rows])
    theirs = get_constellation(SkyCoord(ra_rad, dec_rad, unit="rad"), short_name=True)
    strangers = {
        (short, bright.name_of(hip)) for (short, hip), true in zip(ours, theirs, strict=True) if short != str(true)
    }
    assert strangers == SHARED


def test_no_segment_crosses_the_sky(bright: StarTable) -> None:
    """A wrong star of the same name would give a long segment."""
    ends = [pair for figure in figures(bright) for line in figure.lines for pair in pairwise(line)]
    first, second = (bright.icrs[[bright.row_of_hip[pair[k]] for pair in ends]] for k in (0, 1))
    angle_rad = np.arccos(np.clip(np.sum(first * second, axis=1), -1, 1))
    assert len(ends) > 200
    assert np.all((angle_rad > 0) & (angle_rad < MAX_RAD))


def test_a_table_without_a_joined_star_is_rejected(bright: StarTable) -> None:
    """The error names the constellation and the star."""
    with pytest.raises(CorruptData, match="is not in the table"):
        figures(bright.brighter_than(2.0))

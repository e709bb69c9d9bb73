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
"""Stars of a neighbouring constellation that complete a figure."""


@pytest.fixture(scope="module")
def connected_stars() -> StarTable:
    """Stars of GSS's table that belong to lines of constellations."""
    return load_stars().brighter_than(FAINTEST_JOINED_MAG)


def test_every_designation_is_in_the_star_table(connected_stars: StarTable) -> None:
    """Every line of the table, at least forty, gives a constellation. Orion's belt connects HIP 26727, 26311 and 25930."""
    constellations = figures(connected_stars)
    assert len(constellations) == len(TABLE.strip().splitlines()) >= 40
    assert (26727, 26311, 25930) in next(figure.lines for figure in constellations if figure.short == "Ori")


def test_every_star_is_within_the_official_border_of_its_constellation(connected_stars: StarTable) -> None:
    """All stars are within the borders of 1930 (from astropy), except two that belong to a neighbouring constellation."""
    constellations = figures(connected_stars)
    members = [(figure.short, hip) for figure in constellations for line in figure.lines for hip in line]
    rows = [connected_stars.row_of_hip[hip] for _, hip in members]
    ra_rad, dec_rad = ra_dec_from_unit(connected_stars.icrs[rows])
    constellation_by_border = get_constellation(SkyCoord(ra_rad, dec_rad, unit="rad"), short_name=True)
    outside = {
        (short, connected_stars.name_of(hip))
        for (short, hip), official in zip(members, constellation_by_border, strict=True)
        if short != str(official)
    }
    assert outside == SHARED


def test_all_segments_are_short(connected_stars: StarTable) -> None:
    """No segment is longer than 35°. A wrong star of the same name would give a long segment."""
    ends = [pair for figure in figures(connected_stars) for line in figure.lines for pair in pairwise(line)]
    first, second = (connected_stars.icrs[[connected_stars.row_of_hip[pair[k]] for pair in ends]] for k in (0, 1))
    angle_rad = np.arccos(np.clip(np.sum(first * second, axis=1), -1, 1))
    assert len(ends) > 200
    assert np.all((angle_rad > 0) & (angle_rad < MAX_RAD))


def test_a_table_without_a_connected_star_is_rejected(connected_stars: StarTable) -> None:
    """A star table that lacks a connected star is rejected."""
    with pytest.raises(CorruptData, match="is not in the table"):
        figures(connected_stars.brighter_than(2.0))

"""Star map and report of a catalogue that was read back from the device."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from gss.api.present.catalogue_sheet import catalogue_sheet
from gss.api.present.catalogues import catalogue_detail
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import DistanceTable
from gss.store.models import Catalogue

SIRIUS, UNKNOWN = 32349, 999_999


@pytest.mark.parametrize(("hips", "drawn", "missing"), [((SIRIUS, UNKNOWN), 1, 1), ((UNKNOWN, UNKNOWN + 1), 0, 2)])
def test_stars_without_a_magnitude_are_counted(hips: tuple[int, int], drawn: int, missing: int) -> None:
    """A star whose magnitude neither the bank nor the ground has is not on the map. The response counts these stars,
    so that a page can state why the map is empty."""
    none = np.zeros(0)
    pairs = DistanceTable(none.astype(np.int32), none.astype(np.int32), none, 0.0, 1.0)
    image = OnboardCatalogue(np.array(hips, np.int32), np.eye(3)[:2], np.full(2, np.nan), pairs)
    texts = {"name": "read back", "profile": "cubestar", "format": "cubestar", "author": "ann", "sha256": "ab" * 32}
    row = Catalogue(
        id=1,
        created=datetime(2026, 3, 1, tzinfo=UTC),
        stars=2,
        pairs=0,
        size=64,
        request={},
        manifest={},
        report={},
        **texts,
    )
    detail = catalogue_detail(row, [], image, load_stars())
    assert (len(detail.sky), detail.no_magnitude) == (drawn, missing)
    assert detail.validity_known is False


def test_the_report_states_that_the_validity_is_unknown() -> None:
    """The manifest of a catalogue that was read back has no period of validity. That of a built catalogue has an empty end
    if the catalogue does not expire."""
    known = {"name": "x", "valid_from": "", "valid_to": ""}
    assert "validity unknown" in catalogue_sheet({"hip": [], "source": "read back from the device"}, {}).subtitle
    assert "no end of validity" in catalogue_sheet(known, {}).subtitle

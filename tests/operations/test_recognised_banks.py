"""Recognition of the star of each row in a bank that was read back."""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.operations.transfers.banks import recognise
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import DistanceTable

ALPHA_CENTAURI = (71683, 71681)


def test_both_stars_of_a_close_pair_are_recognised():
    """The two stars of α Centauri, 20″ apart, are recognised as separate stars.

    No magnitudes are needed.
    """
    stars = load_stars(3.0)
    rows = [stars.row_of_hip[hip] for hip in (*ALPHA_CENTAURI, 32349)]
    none = np.empty(0, np.int32)
    bank = OnboardCatalogue(
        hip=np.full(3, -1, np.int32),
        icrs=stars.icrs[rows].astype(np.float32),
        v_mag=np.full(3, np.nan),
        distances=DistanceTable(none, none, np.empty(0), 0.0, 0.1),
    )
    assert recognise(bank, stars) == [*ALPHA_CENTAURI, 32349]

"""Faults of the hunt for false attitudes, and the lists that once misled a chain: they get no answer any more."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.results import Verdict
from validation.never_wrong.faults import FAULTS
from validation.never_wrong.sky import SETTINGS, shown, subject
from validation.never_wrong.table import MODES, judge

STARS = load_stars(8.0)


def test_faults_do_what_they_say() -> None:
    """False stars are added, missing ones left out, mirroring and scale move the places, brightness stays in order."""
    tested = subject(SETTINGS[0], STARS)
    made = {f.title: shown(tested, f, np.eye(3), np.random.default_rng(5)) for f in FAULTS}
    plain = made["no fault"].centroids
    assert len(made["10 false stars"].centroids) == len(plain) + 10
    assert len(made["20 false stars alone"].centroids) == 20
    flipped = made["mirrored"].centroids
    assert np.allclose(flipped.col_px, tested.camera.columns - 1 - plain.col_px)
    assert np.allclose(flipped.row_px, plain.row_px)
    middle = np.array([tested.camera.centre_col_px, tested.camera.centre_row_px])
    wide, narrow = (made[f"focal length {sign}1 %"].truth for sign in "+−")
    both = np.intersect1d(wide.hip, narrow.hip)
    place = [np.array([t.pixels[t.hip.tolist().index(h)] for h in both]) - middle for t in (wide, narrow)]
    assert np.allclose(place[0], place[1] * 1.01 / 0.99)
    for item in made.values():
        assert (np.diff(item.centroids.flux_dn) <= 0).all()


ONCE_WRONG = (
    (1, 0, 8, 2, 71),
    (1, 0, 9, 2, 0),
    (2, 2, 9, 2, 3),
    (2, 2, 9, 2, 5),
    (2, 3, 9, 2, 7),
    (1, 5, 8, 0, 4),
    (1, 5, 8, 1, 13),
    (1, 5, 9, 1, 45),
    (1, 5, 9, 2, 14),
)


@pytest.mark.parametrize("numbers", ONCE_WRONG)
def test_lists_that_misled_a_chain_get_no_answer(numbers: tuple[int, int, int, int, int]) -> None:
    """Stars matched in one corner, or a cluster, at another focal length: none, whichever chain."""
    seed, chain, fault, mode, trial = numbers
    tested = subject(SETTINGS[chain], STARS)
    assert judge(tested, FAULTS[fault], (seed, chain, fault, mode), trial).verdict is Verdict.NONE


def test_trial_is_made_again_by_its_numbers() -> None:
    """The same seed, chain, fault, mode and number give the same score; fault-free tracking is correct."""
    tested = subject(SETTINGS[1], STARS)
    first, again = (judge(tested, FAULTS[0], (3, 1, 0, len(MODES) - 1), 2) for _ in range(2))
    assert first == again
    assert first.verdict in (Verdict.CORRECT, Verdict.IMPRECISE)

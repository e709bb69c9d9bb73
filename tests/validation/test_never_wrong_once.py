"""Faults of the search for wrong attitudes, and lists that once misled a chain."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.results import Verdict
from validation.never_wrong.faults import FAULTS
from validation.never_wrong.sky import SETTINGS, shown, subject
from validation.never_wrong.table import MODES, judge

STARS = load_stars(8.0)


def test_faults_have_the_stated_effects() -> None:
    """False stars are added, mirroring and scale change positions, and lists remain sorted by brightness."""
    tested = subject(SETTINGS[0], STARS)
    lists = {f.title: shown(tested, f, np.eye(3), np.random.default_rng(5)) for f in FAULTS}
    without_fault = lists["no fault"].centroids
    assert len(lists["10 false stars"].centroids) == len(without_fault) + 10
    assert len(lists["20 false stars alone"].centroids) == 20
    flipped = lists["mirrored"].centroids
    assert np.allclose(flipped.col_px, tested.camera.columns - 1 - without_fault.col_px)
    assert np.allclose(flipped.row_px, without_fault.row_px)
    middle = np.array([tested.camera.centre_col_px, tested.camera.centre_row_px])
    wide, narrow = (lists[f"focal length {sign}1 %"].truth for sign in "+−")
    in_both = np.intersect1d(wide.hip, narrow.hip)
    offsets = [np.array([t.pixels[t.hip.tolist().index(h)] for h in in_both]) - middle for t in (wide, narrow)]
    assert np.allclose(offsets[0], offsets[1] * 1.01 / 0.99)
    for item in lists.values():
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
def test_lists_that_misled_a_chain_are_solved_correctly_or_not_at_all(numbers: tuple[int, int, int, int, int]) -> None:
    """Stars matched in one corner or in a cluster at another focal length give no attitude, or the correct one if the chain
    determines the focal length."""
    seed, chain, fault, mode, trial = numbers
    tested = subject(SETTINGS[chain], STARS)
    assert judge(tested, FAULTS[fault], (seed, chain, fault, mode), trial).verdict in (Verdict.NONE, Verdict.CORRECT)


def test_a_trial_is_reproducible_from_its_numbers() -> None:
    """The same seed, chain, fault, mode and trial number give the same result. Tracking without a fault gives an
    attitude that is not wrong.
    """
    tested = subject(SETTINGS[1], STARS)
    first, second = (judge(tested, FAULTS[0], (3, 1, 0, len(MODES) - 1), 2) for _ in range(2))
    assert first == second
    assert first.verdict in (Verdict.CORRECT, Verdict.IMPRECISE)

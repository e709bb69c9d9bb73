"""The number of trials of statistical tests: a share of them in ``make test``, all of them in ``make evidence``."""

from __future__ import annotations

import math

import pytest

SHARE, FEWEST = 0.3, 8
"""``make test`` runs this share of the trials, but not fewer than this number."""


class Trials:
    """Numbers of trials, and of the successes that they must give. With ``every``, all trials run."""

    def __init__(self, every: bool) -> None:
        self._every, self._count = every, 0

    def __call__(self, full: int) -> int:
        """Return how many of ``full`` trials to run."""
        self._count = full if self._every else min(full, max(FEWEST, math.ceil(SHARE * full)))
        return self._count

    def least(self, successes: float, full: int, of: int | None = None) -> float:
        """Return the minimum number of successes of the trials that ran, or of ``of`` of them, if all ``full`` trials
        must give ``successes``. If only a part of the trials ran, two binomial standard deviations fewer are accepted.
        """
        count, share = self._count if of is None else of, successes / full
        slack = 0.0 if self._every else 2 * math.sqrt(count * share * (1 - share))
        return count * share - slack


@pytest.fixture
def trials(pytestconfig: pytest.Config) -> Trials:
    """Number of trials of this test."""
    return Trials(pytestconfig.getoption("--evidence"))

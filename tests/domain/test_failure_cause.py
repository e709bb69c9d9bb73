"""Causes of failed identifications."""

from __future__ import annotations

import pytest

from gss.domain.failure_cause import MIRRORED, OTHER_FOCAL_LENGTH, FailureCause, cause_of


@pytest.mark.parametrize(
    ("reason", "cause"),
    [
        (MIRRORED, FailureCause.MIRRORED),
        (f"3 stars of the bank are here, 9 there: {OTHER_FOCAL_LENGTH}", FailureCause.SCALE),
        ("no three stars agree", FailureCause.NOT_DETERMINED),
        ("", FailureCause.NOT_DETERMINED),
    ],
)
def test_a_reason_gives_the_cause_that_it_names(reason: str, cause: FailureCause) -> None:
    """The texts of the solver give their cause; other reasons give none."""
    assert cause_of(reason) is cause

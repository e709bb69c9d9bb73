"""Date error against a reference, for runs with gaps, lost frames and jitter of the times."""

from __future__ import annotations

import numpy as np
import pytest

from gss.domain.angles import ARCSEC_RAD
from gss.domain.rotation import random_quaternion, turned
from gss.pipeline.analysis.series import AttitudeSeries
from gss.pipeline.sheet.heads import ReferenceErrors, ReferenceInput, reference_errors

DATE_S = 0.05
MEAN_RAD_S = float(np.radians(0.5))
VARYING_RAD_S = float(np.radians(0.1))
RUNS, FRAMES = 12, 20


def errors_of(varying_rad_s: float, gap_s: float = 0.0, lost: float = 0.0, alone: int = 0) -> ReferenceErrors:
    """Compare 12 runs of 20 frames with a reference that differs by a date error. ``gap_s``: between two runs; ``lost``:
    share of frames without an attitude; ``alone``: number of first frames that are moved far away from all others."""
    rng = np.random.default_rng(7)
    n = RUNS * FRAMES
    block = np.repeat(np.arange(RUNS), FRAMES)
    times_s = 10.0 * np.arange(n) + gap_s * block + rng.uniform(-0.05, 0.05, n)
    times_s[:alone] -= 1000.0 * np.arange(alone, 0, -1)
    rate_rad_s = np.zeros((n, 3))
    rate_rad_s[:, 1] = MEAN_RAD_S + varying_rad_s * np.sin(times_s / 400)
    true = [random_quaternion(rng)]
    for k in range(n - 1):
        true.append(turned(true[-1], -0.5 * (rate_rad_s[k] + rate_rad_s[k + 1]) * (times_s[k + 1] - times_s[k])))
    reference = np.array(true)
    measured = turned(reference, -rate_rad_s * DATE_S)
    measured = turned(measured, rng.normal(size=(n, 3)) * np.array([3.0, 3.0, 20.0]) * ARCSEC_RAD)
    measured[rng.random(n) < lost] = np.nan
    counts, covariance = np.full(n, 10, np.intp), np.full((n, 3, 3), np.nan)
    camera, other = (
        AttitudeSeries(times_s, q, covariance, counts, counts, np.full(n, 0.1)) for q in (measured, reference)
    )
    data = ReferenceInput(camera, other, block.astype(np.intp), np.array([0.0, 0, 0, 1]), true_reference=True)
    return reference_errors(data, np.random.default_rng(1))


@pytest.mark.parametrize(
    "case", [{"gap_s": 300.0}, {"lost": 0.1}, {"lost": 0.5}, {"gap_s": 300.0, "lost": 0.1, "alone": 3}]
)
def test_gaps_do_not_change_the_date_error(case: dict[str, float]) -> None:
    """The date error of a camera with a varying rate is found next to gaps and lost frames, and does not appear as a
    bias."""
    errors = errors_of(VARYING_RAD_S, **case)
    assert errors.date_s is not None
    assert errors.bias is not None
    assert errors.date_s.value[0] == pytest.approx(DATE_S, abs=0.005)
    assert np.abs(errors.bias.value).max() < 10 * ARCSEC_RAD


def test_a_constant_rate_with_gaps_gives_no_date_error() -> None:
    """At a constant rate, a date error and a bias cannot be separated, with and without gaps."""
    assert errors_of(0.0, gap_s=300.0, lost=0.1).date_s is None


def test_frames_far_from_all_others_are_not_fitted() -> None:
    """A frame without neighbours has no rate, so it is neither fitted nor counted if a date error is fitted."""
    errors = errors_of(VARYING_RAD_S, alone=3)
    assert errors.pairs == RUNS * FRAMES - 3
    assert np.flatnonzero(np.isnan(errors.rest_rad[:, 0])).tolist() == [0, 1, 2]

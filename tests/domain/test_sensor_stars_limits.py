"""Photometry, star tables, limits and profiles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gss.domain.errors import BadInput, NotFound
from gss.domain.limits import Limits, State
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera, shipped_registry


def table(n: int) -> StarTable:
    """Return a table of n stars with the same direction and different magnitudes."""
    return StarTable(
        np.arange(n, dtype=np.int32),
        np.tile([1.0, 0, 0], (n, 1)),
        np.linspace(6, 1, n),
        np.zeros(n),
        np.zeros((n, 3)),
        np.zeros(n),
        np.zeros(n, np.uint16),
        2000.0,
        {1: "One"},
    )


@pytest.mark.parametrize("p", shipped_registry().cameras().values(), ids=list(shipped_registry().cameras()))
def test_magnitude_and_electrons_are_inverse_and_every_source_is_named(p):
    """Five magnitudes are a factor of 100, a longer exposure has more noise, and every listed source has a text."""
    s = p.sensor
    assert s.star_e(0.0, 1.0) / s.star_e(5.0, 1.0) == pytest.approx(100)
    assert s.magnitude(s.star_e(3.3, 0.2), 0.2) == pytest.approx(3.3)
    assert s.noise_e(s.exposure_max_s) > s.noise_e(s.exposure_min_s) > 0
    assert len(p.sources) >= 5
    assert all(p.sources.values())


def test_unknown_profile_error_lists_the_known_ones():
    """The error for an unknown profile lists the known profiles."""
    with pytest.raises(NotFound, match="sunsat"):
        shipped_camera("hubble")


def test_brightest_come_first_and_names_fall_back_to_the_number():
    """``brighter_than`` sorts by magnitude. The name of an unnamed star is ``HIP n``."""
    bright = table(6).brighter_than(4.0)
    assert bright.v_mag.tolist() == sorted(bright.v_mag.tolist())
    assert bright.v_mag.max() <= 4.0
    assert table(6).name_of(1) == "One"
    assert table(6).name_of(5) == "HIP 5"


def test_columns_of_different_length_are_rejected():
    """A table with columns of different length is rejected with the name of the column."""
    t = table(3)
    with pytest.raises(BadInput, match="v_mag"):
        StarTable(t.hip, t.icrs, t.v_mag[:2], t.b_v, t.proper_motion_rad_yr, t.parallax_rad, t.flags, 2000.0)


LIMITS = Limits(watch=(0, 10), warning=(-5, 15), critical=(-10, 20))


@pytest.mark.parametrize(
    ("value", "state"),
    [
        (0, State.OK),
        (10, State.OK),
        (10.001, State.WATCH),
        (15, State.WATCH),
        (15.001, State.WARNING),
        (-5.001, State.WARNING),
        (20.001, State.CRITICAL),
        (-11, State.CRITICAL),
        (math.nan, State.CRITICAL),
    ],
)
def test_limits_are_inclusive_and_the_worst_level_counts(value, state):
    """A value equal to a limit is within it. The worst violated level is the state. NaN is critical."""
    assert LIMITS.state(value) is state
    assert Limits().state(1e9) is State.OK

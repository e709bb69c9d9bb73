"""Variable stars: the documents' table, and magnitudes of dates that observers recorded."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.corrections.variables import PERIODIC, TABLE_A1, at_date, flagged, magnitude_at
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.stars import FLAG_VARIABLE

BY_NAME = {star.name: star for star in PERIODIC}


def _jyear(jd: float) -> float:
    return 2000.0 + (jd - 2451545.0) / 365.25


@pytest.mark.parametrize("star", PERIODIC, ids=lambda star: star.name)
def test_range_is_reached_and_never_left(star) -> None:  # type: ignore[no-untyped-def]
    """Over one period the magnitude runs from the printed maximum to the printed minimum."""
    epochs = _jyear(star.epoch_jd) + np.linspace(0, 1, 4001) * star.period_d / 365.25
    v_mag = np.array([magnitude_at(star, float(y)) for y in epochs])
    assert v_mag.min() == pytest.approx(star.bright_mag, abs=1e-4)
    assert v_mag.max() == pytest.approx(star.faint_mag, abs=1e-4)
    assert np.abs(np.diff(v_mag)).max() < 0.01 * (star.faint_mag - star.bright_mag)


@pytest.mark.parametrize("star", PERIODIC, ids=lambda star: star.name)
def test_epoch_is_minimum_for_eclipses_and_maximum_for_pulses(star) -> None:  # type: ignore[no-untyped-def]
    """At the epoch, and many periods later, the star is at its printed extreme."""
    extreme = star.bright_mag if star.shape == "pulse" else star.faint_mag
    for cycles in (0, 100):
        jd = star.epoch_jd + cycles * star.period_d
        assert magnitude_at(star, _jyear(jd)) == pytest.approx(extreme, abs=1e-3)


def test_algol_is_dim_for_a_few_hours_only() -> None:
    """Algol spends 86 % of its period at full light, and is within 0.1 mag of minimum for less than three hours."""
    star = BY_NAME["Algol"]
    phase = np.linspace(0, 1, 20_000, endpoint=False)
    v_mag = np.array([magnitude_at(star, _jyear(star.epoch_jd + p * star.period_d)) for p in phase])
    assert np.mean(v_mag == star.bright_mag) == pytest.approx(0.86, abs=0.001)
    assert np.mean(v_mag > star.faint_mag - 0.1) * star.period_d * 24 < 3


def test_delta_cephei_rises_faster_than_it_falls() -> None:
    """δ Cep takes a quarter of its period to rise."""
    star = BY_NAME["δ Cep"]
    phase = np.linspace(0, 1, 4001)
    v_mag = np.array([magnitude_at(star, _jyear(star.epoch_jd + p * star.period_d)) for p in phase])
    assert phase[np.argmax(v_mag)] == pytest.approx(0.75, abs=0.001)


def test_table_a1_stars_are_where_the_document_has_them() -> None:
    """Each row of Table A-1 has the V of its Hipparcos star within its range, half a magnitude for rounding and bands."""
    stars = load_stars()
    found = [row for row in TABLE_A1 if row.hip in stars.row_of_hip]
    assert len(found) == len(TABLE_A1) - 1  # R Leo is fainter than V 8 in the source
    for row in found:
        v_mag = stars.v_mag[stars.row_of_hip[row.hip]]
        assert row.bright_mag - 0.5 < v_mag < row.faint_mag + 0.5, row


def test_algol_is_flagged_by_the_document_only() -> None:
    """Hipparcos's scatter misses Algol's short eclipses; the document's table does not. No other flag is touched."""
    stars = load_stars(6.0)
    marked = flagged(stars)
    new = stars.hip[(marked.flags & ~stars.flags) > 0]
    assert new.tolist() == [14576]
    assert np.array_equal(marked.flags & ~np.uint16(FLAG_VARIABLE), stars.flags & ~np.uint16(FLAG_VARIABLE))


def test_only_periodic_stars_change_with_the_date() -> None:
    """Seven stars get the magnitude of the date, all others keep theirs."""
    stars = load_stars()
    dated = at_date(stars, 2026.9)
    assert set(stars.hip[dated.v_mag != stars.v_mag].tolist()) <= {star.hip for star in PERIODIC}
    mira = dated.v_mag[stars.row_of_hip[10826]]
    assert mira == pytest.approx(magnitude_at(BY_NAME["Mira"], 2026.9))

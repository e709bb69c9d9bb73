"""Variable stars: the document's table, and magnitudes at a date."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.corrections.variables import PERIODIC, TABLE_A1, at_date, flagged, magnitude_at
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.stars import FLAG_VARIABLE

BY_NAME = {star.name: star for star in PERIODIC}


def _jyear(jd: float) -> float:
    """Return the Julian year of a Julian date."""
    return 2000.0 + (jd - 2451545.0) / 365.25


@pytest.mark.parametrize("star", PERIODIC, ids=lambda star: star.name)
def test_magnitudes_cover_exactly_the_printed_range(star) -> None:  # type: ignore[no-untyped-def]
    """Over one period, the magnitude varies continuously between the printed maximum and minimum."""
    epochs = _jyear(star.epoch_jd) + np.linspace(0, 1, 4001) * star.period_d / 365.25
    v_mag = np.array([magnitude_at(star, float(y)) for y in epochs])
    assert v_mag.min() == pytest.approx(star.bright_mag, abs=1e-4)
    assert v_mag.max() == pytest.approx(star.faint_mag, abs=1e-4)
    assert np.abs(np.diff(v_mag)).max() < 0.01 * (star.faint_mag - star.bright_mag)


@pytest.mark.parametrize("star", PERIODIC, ids=lambda star: star.name)
def test_the_epoch_is_a_minimum_for_eclipses_and_a_maximum_for_pulses(star) -> None:  # type: ignore[no-untyped-def]
    """At the epoch and a hundred periods later, the star has its printed extreme magnitude."""
    extreme = star.bright_mag if star.shape == "pulse" else star.faint_mag
    for cycles in (0, 100):
        jd = star.epoch_jd + cycles * star.period_d
        assert magnitude_at(star, _jyear(jd)) == pytest.approx(extreme, abs=1e-3)


def test_algol_is_faint_for_only_a_few_hours() -> None:
    """Algol has its maximum brightness for 86 % of its period, and is within 0.1 mag of the minimum for less than three
    hours.
    """
    star = BY_NAME["Algol"]
    phase = np.linspace(0, 1, 20_000, endpoint=False)
    v_mag = np.array([magnitude_at(star, _jyear(star.epoch_jd + p * star.period_d)) for p in phase])
    assert np.mean(v_mag == star.bright_mag) == pytest.approx(0.86, abs=0.001)
    assert np.mean(v_mag > star.faint_mag - 0.1) * star.period_d * 24 < 3


def test_delta_cephei_brightens_faster_than_it_fades() -> None:
    """δ Cep brightens during a quarter of its period."""
    star = BY_NAME["δ Cep"]
    phase = np.linspace(0, 1, 4001)
    v_mag = np.array([magnitude_at(star, _jyear(star.epoch_jd + p * star.period_d)) for p in phase])
    assert phase[np.argmax(v_mag)] == pytest.approx(0.75, abs=0.001)


def test_stars_of_table_a1_have_the_printed_magnitudes() -> None:
    """The Hipparcos star of each row of Table A-1 has a V within the printed range, extended by 0.5 mag for rounding
    and passbands.
    """
    stars = load_stars()
    in_table = [row for row in TABLE_A1 if row.hip in stars.row_of_hip]
    assert len(in_table) == len(TABLE_A1) - 1  # R Leo is fainter than V 8 in the source
    for row in in_table:
        v_mag = stars.v_mag[stars.row_of_hip[row.hip]]
        assert row.bright_mag - 0.5 < v_mag < row.faint_mag + 0.5, row


def test_only_algol_is_flagged_by_the_document_alone() -> None:
    """The document's table flags Algol, whose short eclipses do not increase the scatter in Hipparcos. No other flag
    changes.
    """
    stars = load_stars(6.0)
    marked = flagged(stars)
    newly_flagged = stars.hip[(marked.flags & ~stars.flags) > 0]
    assert newly_flagged.tolist() == [14576]
    assert np.array_equal(marked.flags & ~np.uint16(FLAG_VARIABLE), stars.flags & ~np.uint16(FLAG_VARIABLE))


def test_only_periodic_stars_change_with_the_date() -> None:
    """Only periodic variables get the magnitude of the date; all other stars keep theirs."""
    stars = load_stars()
    dated = at_date(stars, 2026.9)
    assert set(stars.hip[dated.v_mag != stars.v_mag].tolist()) <= {star.hip for star in PERIODIC}
    mira = dated.v_mag[stars.row_of_hip[10826]]
    assert mira == pytest.approx(magnitude_at(BY_NAME["Mira"], 2026.9))

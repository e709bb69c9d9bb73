"""The star table against well-known stars, published counts, and astropy's space motion."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time

from gss.catalogue_tools.sources.hipparcos import load_stars, photometry, propagate, v_from_hp
from gss.domain.angles import ARCSEC_RAD, separation_rad, unit_from_ra_dec
from gss.domain.errors import BadInput
from gss.domain.stars import FLAG_MULTIPLE, FLAG_NO_PROPER_MOTION, FLAG_POOR_POSITION, FLAG_VARIABLE

ASTROPY_TOLERANCE_RAD = 1e-4 * ARCSEC_RAD
SIRIUS, VEGA, POLARIS, BETELGEUSE, MIRA, CYG_61_A, BETA_MON, XI_UMA = (
    32349,
    91262,
    11767,
    27989,
    10826,
    104214,
    30867,
    55203,
)


@pytest.fixture(scope="module")
def stars():
    return load_stars()


def row(stars, hip):
    (index,) = np.flatnonzero(stars.hip == hip)
    return int(index)


@pytest.mark.parametrize(
    ("hip", "name", "v_mag", "tolerance_mag"),
    [
        (SIRIUS, "Sirius", -1.46, 0.03),
        (VEGA, "Vega", 0.03, 0.01),
        (POLARIS, "Polaris", 1.98, 0.05),
        (BETELGEUSE, "Betelgeuse", 0.45, 0.05),
        (BETA_MON, "β Mon", 3.76, 0.02),
        (CYG_61_A, "61 Cyg", 5.20, 0.02),
    ],
)
def test_known_stars_have_their_names_and_magnitudes(stars, hip, name, v_mag, tolerance_mag):
    """Names and V magnitudes of well-known stars are correct."""
    assert stars.name_of(hip) == name
    assert stars.v_mag[row(stars, hip)] == pytest.approx(v_mag, abs=tolerance_mag)


def test_a_star_without_a_name_is_shown_by_its_number(stars):
    """A star with no name at all shows its Hipparcos number."""
    nameless = next(int(h) for h in stars.hip if int(h) not in stars.names)
    assert stars.name_of(nameless) == f"HIP {nameless}"


@pytest.mark.parametrize(("v_max", "count"), [(3.8, 411), (6.0, 5044), (7.0, 15544), (8.0, 41411)])
def test_counts_by_magnitude_are_those_of_the_source(v_max, count):
    """The number of stars equals that of the published V list, brightest first."""
    stars = load_stars(v_max)
    assert len(stars) == count
    assert np.all(np.diff(stars.v_mag) >= 0)
    assert stars.v_mag.max() <= v_max


def test_proper_motion_of_61_cygni(stars):
    """The flying star moves 5.3 arcseconds a year."""
    motion = stars.proper_motion_rad_yr[row(stars, CYG_61_A)]
    assert np.linalg.norm(motion) / ARCSEC_RAD == pytest.approx(5.28, abs=0.03)


def test_directions_are_unit_vectors_and_motions_tangent(stars):
    """Directions have length one and proper motions lie in the tangent plane."""
    assert np.abs(np.linalg.norm(stars.icrs, axis=1) - 1).max() < 1e-15
    assert np.abs(np.sum(stars.icrs * stars.proper_motion_rad_yr, axis=1)).max() < 1e-18


def test_stars_that_hip2_lacks_are_flagged(stars):
    """Stars such as ξ UMa are included, without proper motion, and flagged."""
    without = (stars.flags & FLAG_NO_PROPER_MOTION) > 0
    assert without.sum() == 17
    assert (without & (stars.v_mag <= 7)).sum() == 7
    assert XI_UMA in stars.hip[without]
    assert np.all(stars.flags[without] & FLAG_POOR_POSITION)
    assert not stars.proper_motion_rad_yr[without].any()


def test_variable_and_double_stars_are_flagged(stars):
    """Mira and Betelgeuse are variable, β Mon is multiple, Vega and Sirius are neither variable nor poorly placed."""
    flags = {hip: stars.flags[row(stars, hip)] for hip in (MIRA, BETELGEUSE, BETA_MON, VEGA, SIRIUS)}
    assert flags[MIRA] & FLAG_VARIABLE
    assert flags[BETELGEUSE] & FLAG_VARIABLE
    assert flags[BETA_MON] & FLAG_MULTIPLE
    assert not flags[VEGA] & FLAG_VARIABLE
    assert not flags[SIRIUS] & (FLAG_VARIABLE | FLAG_POOR_POSITION)


def test_v_agrees_with_hipparcos_own_photometry(stars):
    """Hp − g(V−I) gives the same V as the joined list: 0.02 mag rms over the steady single stars of V ≤ 6."""
    p = photometry()
    error = v_from_hp(p["hp_mag"], p["v_i"]) - stars.v_mag
    steady = ((stars.flags & (FLAG_VARIABLE | FLAG_MULTIPLE)) == 0) & (stars.v_mag <= 6) & np.isfinite(error)
    assert steady.sum() > 3500
    assert np.percentile(np.abs(error[steady]), 99) < 0.06
    assert np.sqrt(np.mean(np.clip(error[steady], -0.2, 0.2) ** 2)) < 0.02


def test_arrays_are_shared_and_read_only():
    """A second load returns the same read-only arrays, so no caller can change another's table."""
    a, b = load_stars(5.0), load_stars(6.0)
    assert np.shares_memory(a.icrs, b.icrs)
    with pytest.raises(ValueError, match="read-only"):
        a.icrs[0, 0] = 2.0


@pytest.mark.parametrize("v_max", [8.01, -2.0, float("nan")])
def test_impossible_depth_is_refused(v_max):
    """A limit beyond the table, brighter than the first star, or not a number raises BadInput."""
    with pytest.raises(BadInput):
        load_stars(v_max)


@pytest.mark.parametrize("epoch_jyear", [1950.0, 2026.9, 2100.0])
def test_propagation_agrees_with_astropy(stars, epoch_jyear):
    """Uniform space motion is astropy's to 0.1 mas, at the pole and for the fastest stars too."""
    fastest = np.argsort(-np.linalg.norm(stars.proper_motion_rad_yr, axis=1))[:25]
    chosen = stars.take(np.concatenate([fastest, [row(stars, POLARIS), row(stars, SIRIUS)]]))
    chosen = chosen.take(chosen.parallax_rad > 1e-9)
    x, y, z = chosen.icrs.T
    ra, dec = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    east = np.stack([-np.sin(ra), np.cos(ra), 0 * ra], axis=1)
    north = np.cross(chosen.icrs, east)
    start = SkyCoord(
        ra=ra * u.rad,
        dec=dec * u.rad,
        pm_ra_cosdec=np.sum(chosen.proper_motion_rad_yr * east, axis=1) * u.rad / u.yr,
        pm_dec=np.sum(chosen.proper_motion_rad_yr * north, axis=1) * u.rad / u.yr,
        distance=(1 / (chosen.parallax_rad / ARCSEC_RAD)) * u.pc,
        radial_velocity=0 * ra * u.km / u.s,
        obstime=Time(chosen.epoch_jyear, format="jyear", scale="tdb"),
    )
    moved = start.apply_space_motion(new_obstime=Time(epoch_jyear, format="jyear", scale="tdb"))
    expected = unit_from_ra_dec(moved.ra.rad, moved.dec.rad)
    # astropy lets light take its time: the tangential speed over c, times the parallax change, stays below the tolerance
    ours = propagate(chosen, epoch_jyear)
    assert separation_rad(ours.icrs, expected).max() < ASTROPY_TOLERANCE_RAD
    assert ours.epoch_jyear == epoch_jyear


def test_propagation_there_and_back_returns(stars):
    """Forward a century and back misses by less than 0.01″: only the radial speed that builds up on the way is lost."""
    back = propagate(propagate(stars, 2091.25), 1991.25)
    assert separation_rad(back.icrs, stars.icrs).max() < 0.01 * ARCSEC_RAD
    assert np.median(separation_rad(back.icrs, stars.icrs)) < 1e-12


@pytest.mark.parametrize("epoch_jyear", [1700.0, 2500.0, float("nan")])
def test_absurd_epoch_is_refused(stars, epoch_jyear):
    """An epoch centuries away is rejected as a mistake."""
    with pytest.raises(BadInput, match="epoch is out of range"):
        propagate(stars, epoch_jyear)

"""The star table, compared with well-known stars, published counts and astropy's space motion."""

import re
from collections import Counter

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time

from gss.catalogue_tools.sources.hipparcos import load_stars, photometry, propagate
from gss.domain.angles import ARCSEC_RAD, separation_rad, unit_from_ra_dec
from gss.domain.errors import BadInput
from gss.domain.stars import FLAG_MULTIPLE, FLAG_NO_PROPER_MOTION, FLAG_POOR_POSITION, FLAG_VARIABLE
from tools.make_faint_star_table import FAINT_TARGET, faint_table, v_from_hp

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
    """Return the row of a star."""
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


def test_a_proper_name_belongs_to_one_star(stars):
    """Only components of a double star and variables with the same designation share a name. Names that the source gives to
    several stars belong to the star in the IAU list, and the other stars have their designation."""
    shared = [name for name, count in Counter(stars.names.values()).items() if count > 1]
    assert shared
    assert not [name for name in shared if not re.fullmatch(r"\S+ [A-Z][A-Za-z]{2}", name)]
    assert [stars.name_of(hip) for hip in (29655, 36046, 28734)] == ["Propus", "ι Gem", "1 Gem"]


def test_a_star_without_a_name_is_named_by_its_number(stars):
    """A star without a name is named by its Hipparcos number."""
    nameless = next(int(h) for h in stars.hip if int(h) not in stars.names)
    assert stars.name_of(nameless) == f"HIP {nameless}"


@pytest.mark.parametrize(("v_max", "count"), [(3.8, 411), (6.0, 5044), (7.0, 15544), (8.0, 41411)])
def test_counts_by_magnitude_agree_with_the_source(v_max, count):
    """The number of stars equals that of the published V list, and stars are sorted by brightness."""
    stars = load_stars(v_max)
    assert len(stars) == count
    assert np.all(np.diff(stars.v_mag) >= 0)
    assert stars.v_mag.max() <= v_max


def test_proper_motion_of_61_cygni(stars):
    """61 Cygni moves by 5.3″ per year."""
    motion = stars.proper_motion_rad_yr[row(stars, CYG_61_A)]
    assert np.linalg.norm(motion) / ARCSEC_RAD == pytest.approx(5.28, abs=0.03)


def test_directions_are_unit_vectors_and_motions_are_tangential(stars):
    """Directions have unit length, and proper motions are perpendicular to them."""
    assert np.abs(np.linalg.norm(stars.icrs, axis=1) - 1).max() < 1e-15
    assert np.abs(np.sum(stars.icrs * stars.proper_motion_rad_yr, axis=1)).max() < 1e-18


def test_stars_missing_in_hip2_are_flagged(stars):
    """Stars that are missing in HIP2, such as ξ UMa, are included without proper motion and flagged."""
    without_motion = (stars.flags & FLAG_NO_PROPER_MOTION) > 0
    assert without_motion.sum() == 17
    assert (without_motion & (stars.v_mag <= 7)).sum() == 7
    assert XI_UMA in stars.hip[without_motion]
    assert np.all(stars.flags[without_motion] & FLAG_POOR_POSITION)
    assert not stars.proper_motion_rad_yr[without_motion].any()


def test_variable_and_double_stars_are_flagged(stars):
    """Mira and Betelgeuse are flagged as variable, and β Mon as multiple. Vega and Sirius are not flagged as variable,
    nor Sirius for a poor position.
    """
    flags = {hip: stars.flags[row(stars, hip)] for hip in (MIRA, BETELGEUSE, BETA_MON, VEGA, SIRIUS)}
    assert flags[MIRA] & FLAG_VARIABLE
    assert flags[BETELGEUSE] & FLAG_VARIABLE
    assert flags[BETA_MON] & FLAG_MULTIPLE
    assert not flags[VEGA] & FLAG_VARIABLE
    assert not flags[SIRIUS] & (FLAG_VARIABLE | FLAG_POOR_POSITION)


def test_v_agrees_with_hipparcos_photometry(stars):
    """Hp − g(V−I) agrees with the V of the table within 0.02 mag rms for constant single stars of V ≤ 6."""
    hipparcos = photometry()
    error = v_from_hp(hipparcos["hp_mag"], hipparcos["v_i"]) - stars.v_mag
    constant_single = ((stars.flags & (FLAG_VARIABLE | FLAG_MULTIPLE)) == 0) & (stars.v_mag <= 6) & np.isfinite(error)
    assert constant_single.sum() > 3500
    assert np.percentile(np.abs(error[constant_single]), 99) < 0.06
    assert np.sqrt(np.mean(np.clip(error[constant_single], -0.2, 0.2) ** 2)) < 0.02


def test_the_tool_makes_the_table_of_faint_stars_again():
    with np.load(FAINT_TARGET) as stored:
        made = faint_table()
        assert made.keys() == set(stored.files)
        for name, column in made.items():
            assert np.array_equal(column, stored[name]), name
            assert column.dtype == stored[name].dtype


def test_arrays_are_shared_and_read_only():
    """Repeated loads return the same read-only arrays, so that no caller can change the table of another."""
    first, second = load_stars(5.0), load_stars(6.0)
    assert np.shares_memory(first.icrs, second.icrs)
    with pytest.raises(ValueError, match="read-only"):
        first.icrs[0, 0] = 2.0


@pytest.mark.parametrize("v_max", [8.01, -2.0, float("nan")])
def test_invalid_magnitude_limits_are_rejected(v_max):
    """A limit fainter than the table, brighter than the brightest star, or not a number is rejected."""
    with pytest.raises(BadInput):
        load_stars(v_max)


@pytest.mark.parametrize("epoch_jyear", [1950.0, 2026.9, 2100.0])
def test_propagation_agrees_with_astropy(stars, epoch_jyear):
    """Uniform space motion agrees with astropy within 0.1 mas, also at the pole and for the fastest stars."""
    fastest = np.argsort(-np.linalg.norm(stars.proper_motion_rad_yr, axis=1))[:25]
    selected = stars.take(np.concatenate([fastest, [row(stars, POLARIS), row(stars, SIRIUS)]]))
    selected = selected.take(selected.parallax_rad > 1e-9)
    x, y, z = selected.icrs.T
    ra, dec = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    east = np.stack([-np.sin(ra), np.cos(ra), 0 * ra], axis=1)
    north = np.cross(selected.icrs, east)
    start = SkyCoord(
        ra=ra * u.rad,
        dec=dec * u.rad,
        pm_ra_cosdec=np.sum(selected.proper_motion_rad_yr * east, axis=1) * u.rad / u.yr,
        pm_dec=np.sum(selected.proper_motion_rad_yr * north, axis=1) * u.rad / u.yr,
        distance=(1 / (selected.parallax_rad / ARCSEC_RAD)) * u.pc,
        radial_velocity=0 * ra * u.km / u.s,
        obstime=Time(selected.epoch_jyear, format="jyear", scale="tdb"),
    )
    moved = start.apply_space_motion(new_obstime=Time(epoch_jyear, format="jyear", scale="tdb"))
    expected = unit_from_ra_dec(moved.ra.rad, moved.dec.rad)
    # astropy includes the light travel time. Its effect, the tangential speed over c times the change of parallax, is
    # below the tolerance.
    propagated = propagate(selected, epoch_jyear)
    assert separation_rad(propagated.icrs, expected).max() < ASTROPY_TOLERANCE_RAD
    assert propagated.epoch_jyear == epoch_jyear


def test_propagation_forward_and_back_is_reversible(stars):
    """Propagation by a century forward and back restores positions within 0.01″; only the change of radial velocity is
    lost.
    """
    restored = propagate(propagate(stars, 2091.25), 1991.25)
    assert separation_rad(restored.icrs, stars.icrs).max() < 0.01 * ARCSEC_RAD
    assert np.median(separation_rad(restored.icrs, stars.icrs)) < 1e-12


@pytest.mark.parametrize("epoch_jyear", [1700.0, 2500.0, float("nan")])
def test_epochs_out_of_range_are_rejected(stars, epoch_jyear):
    """Epochs centuries away and NaN are rejected."""
    with pytest.raises(BadInput, match="epoch is out of range"):
        propagate(stars, epoch_jyear)

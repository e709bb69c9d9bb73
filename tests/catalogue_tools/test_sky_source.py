"""The corrected sky, compared with astropy and ERFA, and combinations of corrections."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from dataclasses import replace

import astropy.units as u
import erfa
import numpy as np
import pytest
from astropy.coordinates import (
    FK4,
    GCRS,
    ICRS,
    CartesianRepresentation,
    FK4NoETerms,
    SkyCoord,
    UnitSphericalRepresentation,
)
from astropy.time import Time
from astropy.utils import iers
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.catalogue_tools.corrections.correction_switches import (
    Corrections,
    MeanOrbitVelocity,
    OrbitVelocity,
    corrections_of,
)
from gss.catalogue_tools.corrections.corrections import crossing_velocity_km_s
from gss.catalogue_tools.corrections.doubles import Doubles
from gss.catalogue_tools.corrections.ephemeris import earth_motion, mean_earth_velocity_c
from gss.catalogue_tools.corrections.fk4 import add_e_terms, from_b1950, remove_e_terms, to_b1950
from gss.catalogue_tools.corrections.sky_source import corrected
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.angles import ARCSEC_RAD, Array, ra_dec_from_unit, separation_rad, unit_from_ra_dec
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera

MAS_RAD = ARCSEC_RAD / 1000
# GSS omits the deflection of light, 4 mas at 90° from the Sun; astropy's GCRS includes it.
APPARENT_TOLERANCE_RAD = 0.01 * MAS_RAD
OF_DATE_TOLERANCE_RAD = 0.001 * MAS_RAD
FK4_TOLERANCE_RAD = 0.001 * MAS_RAD
# SOFA's fk54z follows Standish and Yallop instead of Murray: a different method for the same frame.
SOFA_TOLERANCE_RAD = 12 * MAS_RAD
YEAR = 2026.9


@pytest.fixture(autouse=True)
def _quiet_astropy() -> Iterator[None]:
    """Disable the download of Earth orientation data and the warning that it is missing."""
    with iers.conf.set_temp("auto_download", False), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _time(jyear: float) -> Time:
    return Time(2451545.0, (jyear - 2000.0) * 365.25, format="jd", scale="tt")


def _icrs(unit: Array) -> SkyCoord:
    return SkyCoord(ICRS(UnitSphericalRepresentation.from_cartesian(CartesianRepresentation(unit.T))))


def _sphere(seed: int, count: int) -> Array:
    unit = np.random.default_rng(seed).normal(size=(count, 3))
    return np.asarray(unit / np.linalg.norm(unit, axis=1, keepdims=True))


def test_the_default_correction_is_proper_motion_alone() -> None:
    """With default corrections the sky equals the propagated table bit for bit."""
    stars = load_stars(6.0)
    sky = corrected(stars, Corrections(), YEAR)
    moved = propagate(stars, YEAR)
    assert sky.stars is sky.icrs_stars
    for name in ("hip", "icrs", "v_mag", "b_v", "proper_motion_rad_yr", "parallax_rad", "flags"):
        assert np.array_equal(getattr(sky.stars, name), getattr(moved, name), equal_nan=name == "b_v"), name
    assert sky.frame == "ICRS"
    assert [fact["name"] for fact in sky.facts["applied"]] == ["proper_motion"]
    assert len(sky.rejected) == 0


def test_without_corrections_the_source_is_unchanged() -> None:
    """If proper motion is also disabled, stars have the positions and epoch of the source."""
    stars = load_stars(4.0)
    sky = corrected(stars, Corrections(proper_motion=False), YEAR)
    assert sky.stars is stars
    assert sky.facts["epoch_jyear"] == stars.epoch_jyear
    assert sky.facts["applied"] == []


@pytest.mark.parametrize("jyear", [1995.3, 2013.77, 2026.9])
def test_apparent_positions_agree_with_astropy(jyear: float) -> None:
    """With proper motion, parallax and annual aberration, positions agree with astropy's geocentric positions within
    0.01 mas. ERFA adds the deflection of light by the Sun for the comparison.
    """
    stars = load_stars(6.0)
    stars = stars.take((stars.parallax_rad > 1e-9) & (stars.flags == 0))
    sky = corrected(stars, Corrections(parallax=True, annual_aberration=True), jyear)
    propagated = propagate(stars, jyear)
    # Position in space at the date. astropy applies parallax, aberration and the deflection of light.
    distance = (1 / np.tan(propagated.parallax_rad))[:, None] * propagated.icrs
    apparent = SkyCoord(ICRS(CartesianRepresentation((distance * u.au).T))).transform_to(GCRS(obstime=_time(jyear)))
    expected = apparent.cartesian.xyz.value.T
    expected = expected / np.linalg.norm(expected, axis=1, keepdims=True)
    helio, _ = erfa.epv00(2451545.0, (jyear - 2000.0) * 365.25)
    distance_au = float(np.linalg.norm(helio["p"]))
    parallactic = corrected(stars, Corrections(parallax=True), jyear).stars.icrs
    deflected = erfa.ldsun(parallactic, helio["p"] / distance_au, distance_au)
    with_deflection = sky.stars.icrs + (deflected - parallactic)
    far_from_sun = parallactic @ (-helio["p"] / distance_au) < np.cos(np.radians(20))
    error = separation_rad(with_deflection / np.linalg.norm(with_deflection, axis=1, keepdims=True), expected)[
        far_from_sun
    ]
    assert error.max() < APPARENT_TOLERANCE_RAD


def test_the_omitted_light_deflection_is_small() -> None:
    """The omitted deflection of light is below 12 mas beyond 40° from the Sun."""
    helio, _ = erfa.epv00(2451545.0, 9000.0)
    sun = -helio["p"] / np.linalg.norm(helio["p"])
    unit = _sphere(4, 2000)
    unit = unit[unit @ sun < np.cos(np.radians(40))]
    deflected = erfa.ldsun(unit, -sun, float(np.linalg.norm(helio["p"])))
    assert separation_rad(unit, deflected).max() < 12 * MAS_RAD


@pytest.mark.parametrize("jyear", [1983.0, 2026.9, 2049.1])
def test_axes_of_date_agree_with_erfa(jyear: float) -> None:
    """The mean equator and equinox of date are those of IAU 2006 precession with frame bias, for positions and motions."""
    stars = load_stars(5.0)
    sky = corrected(stars, Corrections(frame="of_date"), jyear)
    matrix = erfa.pmat06(2451545.0, (jyear - 2000.0) * 365.25)
    assert separation_rad(sky.stars.icrs, sky.icrs_stars.icrs @ matrix.T).max() < OF_DATE_TOLERANCE_RAD
    assert np.abs(sky.stars.proper_motion_rad_yr - sky.icrs_stars.proper_motion_rad_yr @ matrix.T).max() < 1e-15
    assert sky.frame == f"mean equator and equinox of J{jyear:.3f}"


@pytest.mark.parametrize("with_e_terms", [True, False])
@pytest.mark.parametrize("jyear", [1950.0, 1991.25, 2026.9])
def test_b1950_agrees_with_astropy(jyear: float, with_e_terms: bool) -> None:
    """FK4 positions of B1950, with and without E-terms, agree with astropy within a microarcsecond."""
    unit = _sphere(1, 500)
    frame = FK4 if with_e_terms else FK4NoETerms
    expected = _icrs(unit).transform_to(frame(equinox="B1950", obstime=_time(jyear))).cartesian.xyz.value.T
    converted, _ = to_b1950(unit, np.zeros_like(unit), jyear, with_e_terms)
    assert separation_rad(converted, expected).max() < FK4_TOLERANCE_RAD


def test_b1950_is_close_to_sofa() -> None:
    """SOFA's fk54z, which uses other matrices, agrees within 12 mas for stars at epoch 1991.25."""
    unit = _sphere(2, 300)
    ra, dec = erfa.fk54z(*ra_dec_from_unit(_icrs(unit).transform_to("fk5").cartesian.xyz.value.T), 1991.25)[:2]
    converted, _ = to_b1950(unit, np.zeros_like(unit), 1991.25, True)
    assert separation_rad(converted, unit_from_ra_dec(ra, dec)).max() < SOFA_TOLERANCE_RAD


@settings(max_examples=60, deadline=None)
@given(
    ra=st.floats(0, 2 * np.pi),
    dec=st.floats(-np.pi / 2, np.pi / 2),
    jyear=st.floats(1850, 2150),
    e_terms=st.booleans(),
    motion=st.floats(-5e-5, 5e-5),
)
def test_b1950_conversion_is_reversible(ra: float, dec: float, jyear: float, e_terms: bool, motion: float) -> None:
    """Conversion to B1950 and back restores any position, including the poles and RA 0, within 5 µas, and its motion
    within 0.1 µas per year.
    """
    unit = unit_from_ra_dec(np.array([ra]), np.array([dec]))
    east = np.array([[-np.sin(ra), np.cos(ra), 0.0]])
    in_b1950 = to_b1950(unit, motion * east, jyear, e_terms)
    assert np.linalg.norm(in_b1950[0]) == pytest.approx(1, abs=1e-14)
    restored, restored_motion = from_b1950(*in_b1950, jyear, e_terms)
    assert separation_rad(restored, unit)[0] < 5e-3 * MAS_RAD
    assert np.abs(restored_motion - motion * east).max() < 1e-4 * MAS_RAD


def test_motion_in_b1950_agrees_with_positions() -> None:
    """The motion on B1950 axes equals the difference of positions one year apart, because the FK4 frame itself rotates."""
    stars = load_stars(4.0)
    before, after = (corrected(stars, Corrections(frame="b1950", e_terms=False), y).stars for y in (2026.0, 2027.0))
    difference = after.icrs - before.icrs
    middle = (before.proper_motion_rad_yr + after.proper_motion_rad_yr) / 2
    assert np.abs(difference - middle).max() < 0.001 * MAS_RAD


@settings(max_examples=40, deadline=None)
@given(ra=st.floats(0, 2 * np.pi), dec=st.floats(-np.pi / 2, np.pi / 2))
def test_e_terms_are_small_and_reversible(ra: float, dec: float) -> None:
    """E-terms shift a position by at most 0.343″, and their removal is exact."""
    unit = unit_from_ra_dec(np.array([ra]), np.array([dec]))
    shifted = add_e_terms(unit)
    assert separation_rad(shifted, unit)[0] < 0.344 * ARCSEC_RAD
    assert separation_rad(remove_e_terms(shifted), unit)[0] < 1e-6 * MAS_RAD


def test_orbital_aberration_agrees_with_astropy() -> None:
    """The velocities of Earth and orbit are added before aberration is applied, as in astropy's position for the moving
    observer.
    """
    stars = load_stars(4.0)
    velocity = (3.1, -6.2, 2.4)
    switches = Corrections(annual_aberration=True, orbital_aberration=OrbitVelocity(velocity))
    positions = corrected(stars, switches, YEAR).stars.icrs
    total = earth_motion(YEAR)[1] + np.array(velocity) / 299_792.458
    expected = erfa.ab(propagate(stars, YEAR).icrs, total, 1e12, np.sqrt(1 - total @ total))
    assert separation_rad(positions, expected).max() < 0.001 * MAS_RAD
    frame = GCRS(
        obstime=_time(YEAR),
        obsgeoloc=CartesianRepresentation([0, 0, 0] * u.m),
        obsgeovel=CartesianRepresentation(np.array(velocity) * u.km / u.s),
    )
    apparent = _icrs(propagate(stars, YEAR).icrs).transform_to(frame).cartesian.xyz.value.T
    sun = -erfa.epv00(2451545.0, (YEAR - 2000.0) * 365.25)[0]["p"]
    far_from_sun = positions @ sun / np.linalg.norm(sun) < np.cos(np.radians(40))
    # Only astropy includes the deflection of light.
    assert separation_rad(positions, apparent)[far_from_sun].max() < 12 * MAS_RAD


def test_velocity_at_the_crossing_agrees_with_a_simulated_orbit() -> None:
    """The formula gives the velocity at the point of a simulated orbit where the boresight is closest to the star."""
    rng = np.random.default_rng(0)
    around = np.linspace(0, 2 * np.pi, 200_001)[:, None]
    for _ in range(4):
        pole, boresight, star = _sphere(int(rng.integers(1e6)), 3)
        first = np.cross(pole, [0, 0, 1.0])
        first /= np.linalg.norm(first)
        zenith = np.cos(around) * first + np.sin(around) * np.cross(pole, first)
        ahead = np.cross(pole, zenith)
        pointing = boresight[0] * ahead - boresight[1] * pole - boresight[2] * zenith
        direction_at_closest = ahead[np.argmax(pointing @ star)]
        velocity = crossing_velocity_km_s(star[None], 7.5, pole, boresight)[0]
        assert np.abs(velocity - 7.5 * direction_at_closest).max() < 1e-3


def test_mean_orbital_aberration_of_an_inertial_field_is_zero() -> None:
    """An inertially fixed field observes each star at all orbit phases, so the first order cancels and no star is
    displaced. A field that rotates with the orbit has the full aberration.
    """
    stars = load_stars(3.0)
    switches = Corrections(orbital_aberration=MeanOrbitVelocity(7.4, (0.0, 0.0, 1.0)))
    assert separation_rad(corrected(stars, switches, YEAR).stars.icrs, propagate(stars, YEAR).icrs).max() < 1e-15
    nadir = Corrections(orbital_aberration=MeanOrbitVelocity(7.4, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)))
    shift = separation_rad(corrected(stars, nadir, YEAR).stars.icrs, propagate(stars, YEAR).icrs)
    assert shift.max() == pytest.approx(7.4 / 299_792.458, rel=1e-3)  # Jacobs 1995 eq. 7.4: 5.1″


def test_mean_velocity_over_a_year_is_nearly_zero() -> None:
    """Over a year the mean velocity of the Earth is nearly zero, and over a day it is that of the date."""
    assert np.linalg.norm(mean_earth_velocity_c(YEAR, 365.25)) < 1e-7
    assert np.linalg.norm(mean_earth_velocity_c(YEAR, 1.0) - earth_motion(YEAR)[1]) < MAS_RAD


def test_negative_parallaxes_are_ignored() -> None:
    """A negative parallax is noise: the star is not displaced, and the facts count it."""
    stars = load_stars(4.0).take(np.arange(3))
    with_parallaxes = replace(stars, parallax_rad=np.array([-1e-6, 0.0, 1e-6]))
    sky = corrected(with_parallaxes, Corrections(parallax=True), YEAR)
    shift = separation_rad(sky.stars.icrs, propagate(with_parallaxes, YEAR).icrs)
    assert shift[0] == shift[1] == 0 < shift[2] < 1.02e-6
    (fact,) = [f for f in sky.facts["applied"] if f["name"] == "parallax"]
    assert (fact["stars"], fact["below_zero"]) == (1, 1)


def test_corrections_are_restored_from_json() -> None:
    """Corrections stored in JSON are restored, and the facts contain only plain values."""
    switches = Corrections(
        parallax=True,
        annual_aberration=True,
        aberration_days=14.0,
        orbital_aberration=MeanOrbitVelocity(7.4, (0.0, 0.1, 1.0), (0.0, 0.0, 1.0)),
        frame="of_date",
        instrument_magnitude=True,
        roll_off="worst",
        doubles=Doubles("huffman", 1e-3),
        flag_variables=True,
        variables_at_date=True,
    )
    assert corrections_of(json.loads(json.dumps(switches.as_dict()))) == switches
    assert corrections_of({}) == Corrections()
    sky = corrected(load_stars(5.0), switches, YEAR, profile=shipped_camera("cubestar"))
    assert json.loads(json.dumps(sky.facts, allow_nan=False))["stars_out"] == len(sky.stars)
    assert {f["name"] for f in sky.facts["applied"]} == set(switches.applied)


def test_selected_rows_can_be_converted_to_the_frame() -> None:
    """Stars selected on ICRS axes and then converted equal the rows of the complete converted table."""
    sky = corrected(load_stars(5.0), Corrections(frame="b1950"), YEAR)
    selected = sky.icrs_stars.take(np.arange(0, len(sky.stars), 7))
    assert np.array_equal(sky.in_frame(selected).icrs, sky.stars.icrs[::7])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Corrections(frame="galactic"), "unknown frame"),
        (lambda: Corrections(roll_off="some"), "roll-off"),
        (lambda: Corrections(frame="b1950", annual_aberration=True), "E-terms"),
        (lambda: Corrections(aberration_days=-1.0), "days of mean"),
        (lambda: Corrections(unknown_b_v=float("nan")), "colour is out of range"),
        (lambda: OrbitVelocity((0.0, 0.0, 7400.0)), "orbital speed"),
        (lambda: MeanOrbitVelocity(7.4, (0.0, 0.0, 0.0)), "is a zero vector"),
        (lambda: corrections_of({"proper_motions": True}), "unknown correction"),
        (lambda: corrections_of({"doubles": {"policy": "none"}}), "policy"),
        (lambda: corrected(load_stars(3.0), Corrections(instrument_magnitude=True), YEAR), "needs the camera"),
        (lambda: corrected(load_stars(3.0), Corrections(), 1066.0), "date is out of range"),
        (lambda: corrected(load_stars(3.0), Corrections(), YEAR, date_jyear=float("nan")), "date is out of range"),
    ],
)
def test_invalid_corrections_are_rejected(make, message) -> None:  # type: ignore[no-untyped-def]
    """Each invalid correction is rejected, and the error names the field."""
    with pytest.raises(BadInput, match=message):
        make()

"""Occultation by Earth, Sun and Moon for every pointing law, compared with brute force and with astropy."""

import astropy.units as units
import numpy as np
import pytest
from astropy.coordinates import GCRS, get_body
from astropy.time import Time

from gss.catalogue_tools.design.baffle_search import AvoidanceAngles
from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.envelope.blocks import BlockEnvelope
from gss.catalogue_tools.envelope.envelope import BandEnvelope, PatchEnvelope, WholeSky
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.healpix import centres
from gss.catalogue_tools.envelope.hidden_bands import seen_bands
from gss.catalogue_tools.envelope.occultation import Occultation, OccultedEnvelope
from gss.catalogue_tools.envelope.orbits import from_elements
from gss.catalogue_tools.envelope.views import views_of
from gss.catalogue_tools.selection.counting import fields_per_star
from gss.catalogue_tools.selection.quality import assess
from gss.domain.angles import separation_rad
from gss.domain.errors import BadInput
from gss.domain.rotation import rotation_x
from gss.instruments.registry import shipped_camera

START, END = 2026.92, 2026.92 + 14 / 365.25
UNIT = np.concatenate([centres(16), [[0, 0, 1.0], [0, 0, -1.0]]])


def deg(*values):
    return tuple(float(np.radians(v)) for v in values)


def planes(inclination, low, high):
    return from_elements(deg(inclination, inclination), deg(low, high))


SUNSAT, CUBESTAR = (FieldShape(shipped_camera(name).camera) for name in ("sunsat", "cubestar"))
SUNSAT_LIMITS = AttitudeLimits("sunsat", deg(-10, 10), deg(-5, 5), deg(130, 140))
SIDE = AttitudeLimits("target", off_nadir_rad=0.5, body_from_cam=tuple(rotation_x(2.0).ravel()))
ALL = Occultation(700e3, *deg(20, 28.1, 28.1))
CASES = {
    "sunsat, Earth": (BandEnvelope(SUNSAT, SUNSAT_LIMITS, planes(97, 133, 149)), Occultation(700e3, *deg(28))),
    "sunsat, all": (BandEnvelope(SUNSAT, SUNSAT_LIMITS, planes(97, 133, 149)), ALL),
    "sunsat, a year of nodes": (BandEnvelope(SUNSAT, SUNSAT_LIMITS, planes(97, 0, 360)), ALL),
    "zenith, tilted": (
        BandEnvelope(CUBESTAR, AttitudeLimits("zenith", deg(50, 70), deg(-3, 3), deg(-5, 5)), planes(97.6, 350, 364)),
        Occultation(500e3, *deg(10, 45, 20)),
    ),
    "nadir, past the limb": (
        BandEnvelope(SUNSAT, AttitudeLimits("nadir", deg(50, 75), deg(-3, 3)), planes(51.6, 0, 10)),
        Occultation(400e3),
    ),
    "target": (BandEnvelope(SUNSAT, SIDE, planes(51.6, 350, 370)), Occultation(400e3, *deg(5, 30))),
    "inertial": (
        PatchEnvelope(CUBESTAR, AttitudeLimits("inertial", deg(-9, 9), deg(-9, 9), deg(-20, 20), *deg(290, -10, 0))),
        Occultation(700e3, *deg(20, 40, 10)),
    ),
    "inertial, over the pole": (
        PatchEnvelope(SUNSAT, AttitudeLimits("inertial", deg(-5, 5), deg(-5, 5), deg(0, 0), *deg(2, 88, 0))),
        Occultation(700e3, *deg(20, 113)),
    ),
    "anti-Sun": (
        PatchEnvelope(SUNSAT, AttitudeLimits("anti_sun", deg(-8, 8), deg(-8, 8), deg(-5, 5)), deg(250, 264)),
        Occultation(700e3, *deg(20, 172, 10)),
    ),
    "beside the Sun": (
        PatchEnvelope(SUNSAT, AttitudeLimits("sun_pointing", deg(-1, 1), deg(-9, 9), deg(-40, 40)), deg(250, 264)),
        Occultation(700e3, *deg(20, 85)),
    ),
    "whole sky": (WholeSky(SUNSAT), Occultation(None, 0.0, *deg(80, 20))),
}


def occulted_envelope(name):
    base, occultation = CASES[name]
    return OccultedEnvelope(base, occultation, getattr(base, "orbit", planes(97, 0, 14)), START, END)


@pytest.fixture(scope="module", params=CASES)
def case(request):
    """Return an envelope, which directions it contains, and random usable fields."""
    envelope = occulted_envelope(request.param)
    return envelope, envelope.contains(UNIT), envelope.usable_moments(np.random.default_rng(5), 12_000)


def test_membership_agrees_with_brute_force_over_the_sphere(case):
    """For every pointing law, including RA 0 and the poles, no usable field shows an omitted star, and every included
    star is in a usable field unless it is near the edge.
    """
    envelope, included, moments = case
    shown = fields_per_star(UNIT, moments.cam_from_icrs, envelope.shape, envelope.shadow(moments)) > 0
    assert included.any()
    assert not np.any(shown & ~included)
    missing = np.flatnonzero(included & ~shown)
    edge = UNIT[~included] if (~included).any() else UNIT[shown]
    edge_distances = [
        min(separation_rad(UNIT[m], edge).min(), separation_rad(UNIT[m], UNIT[shown]).min()) for m in missing
    ]
    assert all(r < np.radians(8) for r in edge_distances)
    assert len(missing) < 0.25 * included.sum()


def test_usable_fields_keep_the_avoidance_angles(case):
    """Every usable boresight is at least the margin away from the limb, and at least the baffle's angles away from Sun
    and Moon.
    """
    envelope, _, moments = case
    occultation, boresight = envelope.occultation, moments.cam_from_icrs[:, 2]
    if occultation.altitude_m is not None:
        assert separation_rad(boresight, moments.nadir).min() >= occultation.earth_rad - 1e-9
    if occultation.baffled:
        sun, moon = envelope.baffle.bodies(moments.part)
        assert separation_rad(boresight, sun).min() >= occultation.sun_rad - 1e-9
        assert separation_rad(boresight, moon).min() >= occultation.moon_rad - 1e-9


def test_occultation_only_removes_stars(case):
    """The envelope with occulting bodies is inside the envelope without them, and the total time fraction is reduced by
    the blinded share.
    """
    envelope, included, _ = case
    assert not np.any(included & ~envelope.base.contains(UNIT))
    share = envelope.time_fraction(UNIT)
    assert not np.any((share > 0) & ~included)
    assert share[:-2].mean() * 4 * np.pi <= envelope.shape.area_sr * (1 - envelope.blinded.total) * 1.12


def test_shares_of_blinded_time_are_consistent(case):
    """No body blinds longer than all together, all together no longer than the sum, and the share of unusable random
    fields is the total.
    """
    blinded = case[0].blinded
    bodies = (blinded.earth, blinded.sun, blinded.moon)
    assert max(bodies) - 1e-12 <= blinded.total <= min(1.0, sum(bodies)) + 1e-12
    cube = np.random.default_rng(8).random((20_000, case[0].dimensions))
    assert np.mean(~case[0].usable(case[0].at(cube))) == pytest.approx(blinded.total, abs=0.02)


@pytest.mark.parametrize("name", ["sunsat, Earth", "nadir, past the limb", "zenith, tilted"])
def test_limits_of_the_unocculted_band_are_exact(name):
    """The limits of the angle from the orbit's axis at which a clear view exists contain those of random views and
    exceed them by less than 0.3°.
    """
    base, occultation = CASES[name]
    bands = seen_bands(base, views_of(base.shape, base.limits), occultation.earth_rad)
    limit = np.cos(occultation.earth_rad)
    angles = []
    for seed in range(10, 20):
        views = views_of(base.shape, base.limits, seed)
        angles.append(views.from_y_rad[(views.direction[:, 2] <= limit) & (views.boresight[:, 2] <= limit)])
    angles = np.concatenate(angles)
    ends = [(np.arccos(high), np.arccos(low)) for low, high in bands]
    assert np.any([(angles >= a - 1e-9) & (angles <= b + 1e-9) for a, b in ends], axis=0).all()
    assert angles.min() - min(a for a, _ in ends) < np.radians(0.3)
    assert max(b for _, b in ends) - angles.max() < np.radians(0.3)


def test_without_the_earth_the_band_is_complete():
    """Without the Earth, the visible band is the single interval of the exact band."""
    base = CASES["sunsat, Earth"][0]
    assert seen_bands(base, views_of(base.shape, base.limits), 0.0) == [base.polar_interval]
    assert not Occultation().active


def test_sun_and_moon_agree_with_astropy():
    """Geocentric directions agree with astropy within 0.1° over a year."""
    baffle, part = AvoidanceAngles(1.0, 1.0, 2026.0, 2027.0), np.linspace(0, 1, 40)
    times = Time(2026.0 + part, format="jyear", scale="tt")
    for name, directions in zip(("sun", "moon"), baffle.bodies(part), strict=True):
        position = get_body(name, times, ephemeris="builtin").transform_to(GCRS(obstime=times)).cartesian.xyz
        expected = position.to_value(units.km).T
        expected = expected / np.linalg.norm(expected, axis=1, keepdims=True)
        assert separation_rad(directions, expected).max() < np.radians(0.1)


def test_moments_and_attitudes_cover_the_same_region():
    """The two ways to draw random fields of an envelope cover the same region of the sky."""
    for base, _ in CASES.values():
        cube = np.random.default_rng(3).random((4000, base.dimensions))
        moments = base.at(cube)
        assert np.abs(moments.cam_from_icrs @ np.swapaxes(moments.cam_from_icrs, 1, 2) - np.eye(3)).max() < 1e-12
        attitudes = base.attitudes(np.random.default_rng(4), 4000)
        assert np.abs(moments.cam_from_icrs[:, 2].mean(axis=0) - attitudes[:, 2].mean(axis=0)).max() < 0.06
        assert base.contains(moments.cam_from_icrs[:100, 2]).all()


def test_the_node_moves_with_the_date():
    """The orbital plane has the first node at the start of validity and the last one at its end."""
    base = CASES["sunsat, Earth"][0]
    cube = np.full((2, 6), 0.5)
    cube[:, 0] = 0.0, 1.0
    normal = np.cross(base.at(cube).nadir, base.at(np.where(np.arange(6) == 2, 0.7, cube)).nadir)
    raan = np.arctan2(normal[:, 0], -normal[:, 1])
    assert np.degrees(raan) == pytest.approx([133, 149], abs=1e-6)


def test_target_pointing_is_limited_to_the_off_nadir_angle():
    """The law *target* limits roll and pitch to the off-nadir angle. Other laws reject this angle."""
    assert SIDE.low[:2] == pytest.approx([-0.5, -0.5])
    with pytest.raises(BadInput, match="off-nadir"):
        AttitudeLimits("zenith", off_nadir_rad=0.1)


def test_sun_pointing_covers_a_ring_around_the_sun():
    """With the law sun_pointing and free yaw, the boresight is within 20° of a right angle to the Sun and covers the
    whole ring around it.
    """
    limits = AttitudeLimits("sun_pointing", yaw_rad=deg(-180, 180))
    base = PatchEnvelope(SUNSAT, limits, deg(250, 264))
    sun, _ = AvoidanceAngles(1.0, 0.0, START, END).bodies(np.array([0.5]))
    moments = base.at(np.column_stack([np.full(50, 0.5), np.zeros((50, 2)), np.linspace(0, 1, 50)]))
    assert separation_rad(moments.cam_from_icrs[:, 2], sun[0]) == pytest.approx(np.pi / 2, abs=np.radians(20))
    spread = separation_rad(moments.cam_from_icrs[:1, 2], moments.cam_from_icrs[:, 2])
    assert spread.max() > np.radians(175)


def test_quality_counts_unocculted_stars_in_usable_fields():
    """With the Earth in the field, fewer stars are counted, and the share of lost time is reported."""
    envelope = occulted_envelope("zenith, tilted")
    unit = centres(16)
    without_earth = assess(unit, envelope.base, CUBESTAR, 2000, np.random.default_rng(1))
    with_earth = assess(unit, envelope, CUBESTAR, 2000, np.random.default_rng(1))
    assert with_earth.mean < without_earth.mean
    assert with_earth.blinded_share == envelope.blinded.total
    assert without_earth.blinded_share == 0.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Occultation(50e3), "too low for an orbit"),
        (lambda: Occultation(float("nan")), "too low for an orbit"),
        (lambda: Occultation(700e3, -0.1), "earth margin angle is out of range"),
        (lambda: Occultation(700e3, 2.5), "cover the whole sky"),
        (lambda: Occultation(sun_rad=4.0), "sun angle is out of range"),
        (lambda: Occultation(moon_rad=float("nan")), "moon angle is out of range"),
        (lambda: OccultedEnvelope(WholeSky(SUNSAT), Occultation(sun_rad=0.5)), "need dates"),
        (lambda: BlockEnvelope(SUNSAT, SUNSAT_LIMITS, planes(97, 0, 1), rule="most"), "unknown rule for blocks"),
    ],
)
def test_invalid_occultations_are_rejected(make, message):
    """Each kind of invalid input raises BadInput with the reason."""
    with pytest.raises(BadInput, match=message):
        make()


def test_a_camera_without_usable_fields_is_rejected():
    """A camera that points to nadir has no usable field. The error states expected value, actual value and a hint."""
    nadir = BandEnvelope(SUNSAT, AttitudeLimits("nadir"), planes(97, 0, 1))
    envelope = OccultedEnvelope(nadir, Occultation(700e3))
    assert not envelope.contains(UNIT).any()
    with pytest.raises(BadInput, match="every field is blinded") as error:
        envelope.attitudes(np.random.default_rng(1), 10)
    assert error.value.expected
    assert error.value.got
    assert error.value.hint

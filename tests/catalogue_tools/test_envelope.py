"""Envelopes compared with brute force over the sphere and with the sub-catalogue sizes of Jacobs 1995 §5.2."""

import itertools

import numpy as np
import pytest

from gss.catalogue_tools.envelope.attitude import AttitudeLimits, euler_123, orbit_axes
from gss.catalogue_tools.envelope.envelope import BandEnvelope, PatchEnvelope, WholeSky
from gss.catalogue_tools.envelope.field import FieldShape, widened
from gss.catalogue_tools.envelope.healpix import centres
from gss.catalogue_tools.envelope.orbits import from_elements
from gss.catalogue_tools.envelope.reach import cosine_range
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import separation_rad, unit_from_ra_dec
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs, orbit_from_icrs
from gss.domain.rotation import rotation_x, rotation_y, rotation_z
from gss.instruments.registry import shipped_camera, shipped_registry


def deg(*values):
    return tuple(float(np.radians(v)) for v in values)


SUNSAT_LIMITS = AttitudeLimits("sunsat", deg(-10, 10), deg(-5, 5), deg(130, 140))


def sunsat(raan_low, raan_high, inclination=97.0):
    """Return Sunsat's envelope for a range of nodes."""
    planes = from_elements(deg(inclination, inclination), deg(raan_low, raan_high))
    return BandEnvelope(FieldShape(shipped_camera("sunsat").camera), SUNSAT_LIMITS, planes)


def visible_by_sampling(envelope, unit, count, seed=1):
    """Return which directions are in the field of at least one of ``count`` random attitudes."""
    visible = np.zeros(len(unit), bool)
    for attitude in envelope.attitudes(np.random.default_rng(seed), count):
        visible |= envelope.shape.inside(unit @ attitude.T)
    return visible


def visible_by_steps(limits, shape, unit, raan_deg, inclination_deg, per_axis, per_orbit):
    """Return which directions are visible by Jacobs' method: step through all combinations of the six parameters,
    limits included.
    """
    visible = np.zeros(len(unit), bool)
    latitude = np.arange(per_orbit) * 2 * np.pi / per_orbit
    boxes = [np.linspace(a, b, per_axis) for a, b in zip(limits.low, limits.high, strict=True)]
    for raan, inclination in itertools.product(raan_deg, inclination_deg):
        orbit = orbit_axes(np.full(per_orbit, np.radians(raan)), np.full(per_orbit, np.radians(inclination)), latitude)
        for angles in itertools.product(*boxes):
            cam = limits.cam_from_body @ euler_123(angles) @ orbit
            visible |= shape.inside(np.einsum("kij,nj->kni", cam, unit)).any(axis=0)
    return visible


@pytest.mark.parametrize(("inclination", "declination"), [(0, -90), (90, 0), (97, 7)])
def test_sunsat_boresight_has_the_declination_of_the_document(inclination, declination):
    """With yaw 135°, the boresight on orbits with i = 0, 90 and 97° is at Dec −90, 0 and +7° at every latitude
    argument.
    """
    limits = AttitudeLimits("sunsat", yaw_rad=deg(135, 135))
    for latitude in np.linspace(0, 2 * np.pi, 7):
        orbit = orbit_from_icrs(0.4, np.radians(inclination), latitude)
        boresight = (limits.cam_from_body @ euler_123(limits.low) @ orbit)[2]
        assert np.degrees(np.arcsin(np.clip(boresight[2], -1, 1))) == pytest.approx(declination, abs=1e-5)


def test_euler_rotation_is_the_product_of_the_three_matrices():
    """The Euler rotation is eq. 1.13 without its misprints."""
    product = rotation_z(0.3) @ rotation_y(-0.2) @ rotation_x(1.1)
    assert np.abs(euler_123([1.1, -0.2, 0.3]) - product).max() < 1e-15


def test_orbit_axes_agree_with_the_orbit_frame():
    """The axes for arrays of orbits agree with ``orbit_from_icrs``."""
    assert np.abs(orbit_axes(0.3, 1.7, 2.0) - orbit_from_icrs(0.3, 1.7, 2.0)).max() < 1e-15


@pytest.mark.parametrize("attitude_of", [("zenith", -1.0), ("nadir", 1.0)])
def test_zenith_and_nadir_boresights_point_up_and_down(attitude_of):
    """The boresight is opposite to the orbit frame's +z for zenith, and along it for nadir."""
    law, sign = attitude_of
    assert AttitudeLimits(law).cam_from_body[2] == pytest.approx([0, 0, sign])


def test_cosine_range_agrees_with_a_fine_grid():
    """The range of a cosine over any interval equals that on a fine grid."""
    rng = np.random.default_rng(5)
    for low, width, peak in rng.uniform([-7, 0, -7], [7, 8, 7], (200, 3)):
        grid = 2.5 * np.cos(np.linspace(low, low + width, 20001) - peak)
        assert cosine_range(np.array(2.5), np.array(peak), low, low + width) == pytest.approx(
            (grid.min(), grid.max()), abs=1e-6
        )


@pytest.mark.parametrize(
    ("raan", "paper", "exact"), [((133, 149), 113, 144), ((0, 120), 540, 600), ((0, 360), 1300, 1433)]
)
def test_sub_catalogues_of_jacobs_are_reproduced(raan, paper, exact):
    """Jacobs found 113, 540 and 1300 stars with coarse steps. The exact envelope contains 10 % to 27 % more."""
    count = int(sunsat(*raan).contains(load_stars(6.0).icrs).sum())
    assert count == exact
    assert 1.0 < count / paper < 1.3


def test_steps_of_jacobs_find_the_same_stars_except_at_corners():
    """Jacobs' steps find no star outside the exact envelope and over 90 % of those inside. Only corners of the field
    reach the others.
    """
    stars = load_stars(6.0)
    envelope = sunsat(133, 149)
    geometric = envelope.contains(stars.icrs)
    same_side = stars.icrs @ stars.icrs[geometric].mean(axis=0) > 0
    stepped = visible_by_steps(
        SUNSAT_LIMITS, envelope.shape, stars.icrs[same_side], np.arange(133, 150, 4), [97], 3, 90
    )
    assert not np.any(stepped & ~geometric[same_side])
    assert np.count_nonzero(stepped) > 0.9 * np.count_nonzero(geometric)


BANDS = {
    "zenith": (AttitudeLimits("zenith", deg(-5, 5), deg(-5, 5), deg(-5, 5)), "cubestar", (97.6, 97.6), (49, 63)),
    "nadir, node across 0°": (
        AttitudeLimits("nadir", deg(-3, 3), deg(0, 4), deg(0, 90)),
        "sunsat",
        (51, 53),
        (350, 372),
    ),
    "equatorial, looking at the poles": (SUNSAT_LIMITS, "sunsat", (0, 2), (0, 360)),
    "wide yaw": (AttitudeLimits("zenith", deg(20, 30), deg(-1, 1), deg(-180, 180)), "oersted", (90, 90), (10, 11)),
}


@pytest.mark.parametrize("name", BANDS)
def test_band_agrees_with_brute_force_over_the_sphere(name):
    """Over the whole sphere, including RA 0 and the poles, sampling finds no direction outside the envelope, and all
    those inside except near its edge.
    """
    limits, camera, inclination, raan = BANDS[name]
    shape = FieldShape(shipped_camera(camera).camera)
    envelope = BandEnvelope(shape, limits, from_elements(deg(*inclination), deg(*raan)))
    unit = np.concatenate([centres(16), [[0, 0, 1.0], [0, 0, -1.0]]])
    sampled, geometric = visible_by_sampling(envelope, unit, 2500), envelope.contains(unit)
    assert not np.any(sampled & ~geometric)
    missing = np.flatnonzero(geometric & ~sampled)
    edge_distances = [separation_rad(unit[m], unit[~geometric]).min() if (~geometric).any() else np.pi for m in missing]
    assert all(r < np.radians(14) for r in edge_distances)
    assert len(missing) < 0.3 * geometric.sum()


def test_polar_interval_of_the_band_is_exact():
    """The polar interval contains the extremes over a fine grid of attitudes and the whole outline, within 1e-4 rad."""
    envelope = sunsat(133, 149)
    boxes = [np.linspace(a, b, 21) for a, b in zip(SUNSAT_LIMITS.low, SUNSAT_LIMITS.high, strict=True)]
    rotation = euler_123(np.array(list(itertools.product(*boxes))))
    y = (envelope.shape.outline @ SUNSAT_LIMITS.cam_from_body) @ rotation[:, :, 1].T
    lowest, highest = envelope.polar_interval
    assert -1e-12 <= y.min() - lowest < 1e-4
    assert highest == 1.0


PATCHES = {
    "round the pole": AttitudeLimits("inertial", deg(-3, 3), deg(-2, 4), deg(-30, 20), *deg(1, 88, 40)),
    "across 0h": AttitudeLimits("inertial", deg(-1, 1), deg(-1, 1), deg(0, 0), *deg(359.5, -20, 10)),
    "free roll": AttitudeLimits("inertial", deg(-2, 2), deg(-2, 2), deg(-180, 180), *deg(200, 10, 0)),
    "anti-Sun": AttitudeLimits("anti_sun", deg(-3, 3), deg(-2, 2), deg(-10, 10)),
}


@pytest.mark.parametrize("name", PATCHES)
@pytest.mark.parametrize("camera", ["sunsat", "cubestar"])
def test_patch_agrees_with_brute_force_over_the_sphere(name, camera):
    """For pointing laws that do not rotate with the orbit, sampling finds no direction outside the envelope, and all
    those inside except near its edge.
    """
    envelope = PatchEnvelope(FieldShape(shipped_camera(camera).camera), PATCHES[name], deg(355, 362))
    unit = np.concatenate([centres(32), [[0, 0, 1.0], [0, 0, -1.0]]])
    sampled, geometric = visible_by_sampling(envelope, unit, 1500), envelope.contains(unit)
    assert geometric.any()
    assert not np.any(sampled & ~geometric)
    missing = np.flatnonzero(geometric & ~sampled)
    edge_distances = [separation_rad(unit[m], unit[~geometric]).min() for m in missing]
    assert all(r < np.radians(4) for r in edge_distances)


@pytest.mark.parametrize("name", [i.name for i in shipped_registry().all() if i.profile.chain])
def test_field_shape_agrees_with_the_detector(name):
    """For every camera, directions two pixels inside the edge of the detector are in the shape, and directions two
    pixels outside are not.
    """
    camera = shipped_camera(name).camera
    shape = FieldShape(camera)
    assert shape.inside(widened(camera, -2 * camera.pixel_rad).outline(37)).all()
    assert not shape.inside(widened(camera, 2 * camera.pixel_rad).outline(37)).any()
    rng = np.random.default_rng(2)
    unit = rng.normal(size=(20_000, 3)) * [0.3, 0.3, 0] + [0, 0, 1]
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    inner = camera.contains(camera.project(unit)) & (unit[:, 2] > np.cos(shape.half_diagonal_rad * 1.01))
    assert np.mean(shape.inside(unit) == inner) > 0.9995


@pytest.mark.parametrize("name", ["cubestar", "sunsat"])
def test_a_near_field_is_never_excluded(name):
    """``may_be_within`` is true for every field within the margin and false for most fields clearly outside."""
    shape = FieldShape(shipped_camera(name).camera)
    rng = np.random.default_rng(8)
    unit = rng.normal(size=(400, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    distance = np.array([0.0 if shape.inside(u) else separation_rad(u, shape.outline).min() for u in unit])
    assert shape.may_be_within(unit, distance + 1e-3).all()
    clearly_outside = distance > np.radians(3)
    assert np.mean(shape.may_be_within(unit[clearly_outside], 0.5 * distance[clearly_outside])) < 0.5


def test_margin_widens_the_field():
    """A margin of 0.5° widens both fields of view by 1.0° ± 0.03°."""
    camera = shipped_camera("sunsat").camera
    wider = np.degrees(widened(camera, np.radians(0.5)).fov_rad)
    assert wider - np.degrees(camera.fov_rad) == pytest.approx([1.0, 1.0], abs=0.03)


@pytest.mark.parametrize("envelope", [sunsat(133, 149), sunsat(0, 360)])
def test_time_in_field_integrates_to_the_solid_angle(envelope):
    """The time fraction integrated over the sky is the solid angle of the field, and it is at most 1 everywhere."""
    share = envelope.time_fraction(centres(32))
    assert share.sum() * 4 * np.pi / len(share) == pytest.approx(envelope.shape.area_sr, rel=0.01)
    assert 0 <= share.min() <= share.max() <= 1


def test_time_in_field_of_a_patch_integrates_to_the_solid_angle():
    """The time fraction of an inertially fixed camera also integrates to the solid angle of its field."""
    envelope = PatchEnvelope(FieldShape(shipped_camera("sunsat").camera), PATCHES["round the pole"])
    share = envelope.time_fraction(centres(32))
    assert share.sum() * 4 * np.pi / len(share) == pytest.approx(envelope.shape.area_sr, rel=0.05)


def test_time_in_field_agrees_with_sampled_attitudes():
    """The time fraction of a position is the share of random attitudes that have it in the field."""
    envelope = sunsat(133, 149)
    positions = unit_from_ra_dec(np.radians([231.0, 231.0, 225.0]), np.radians([7.0, 15.0, 0.0]))
    attitudes = envelope.attitudes(np.random.default_rng(4), 20_000)
    sampled = np.array([envelope.shape.inside(attitudes @ p).mean() for p in positions])
    assert envelope.time_fraction(positions) == pytest.approx(sampled, abs=0.012)


def test_edges_are_on_the_border_of_the_envelope():
    """At the node of an edge, positions just inside the edge are visible and positions just outside are not."""
    envelope = sunsat(133, 149)
    for at_end, raan in ((False, 133), (True, 149)):
        (line,) = envelope.edges(at_end)
        at_that_node = sunsat(raan, raan)
        middle = line.mean(axis=0) / np.linalg.norm(line.mean(axis=0))
        inner, outer = line + 1e-3 * (middle - line), line - 1e-3 * (middle - line)
        assert at_that_node.contains(inner / np.linalg.norm(inner, axis=1, keepdims=True)).all()
        assert not at_that_node.contains(outer / np.linalg.norm(outer, axis=1, keepdims=True)).any()


def test_edge_of_an_inertially_fixed_camera_is_its_field():
    """The edge of an inertially fixed camera is the outline of its field."""
    limits = AttitudeLimits("inertial", ra_rad=1.0, dec_rad=0.5, field_roll_rad=2.0)
    shape = FieldShape(shipped_camera("cubestar").camera)
    (line,) = PatchEnvelope(shape, limits).edges(False)
    visible = line @ cam_from_icrs(1.0, 0.5, 2.0).T
    assert shape.camera.contains(shape.camera.project(visible), margin_px=-1).all()
    assert not shape.camera.contains(shape.camera.project(visible), margin_px=1).any()


def test_random_attitudes_are_rotations_into_the_envelope():
    """Random attitudes of every envelope are proper rotations with their boresight inside the envelope."""
    shape = FieldShape(shipped_camera("sunsat").camera)
    for envelope in (sunsat(133, 149), WholeSky(shape), PatchEnvelope(shape, PATCHES["across 0h"])):
        attitudes = envelope.attitudes(np.random.default_rng(6), 200)
        assert np.abs(attitudes @ np.swapaxes(attitudes, 1, 2) - np.eye(3)).max() < 1e-12
        assert np.linalg.det(attitudes) == pytest.approx(np.ones(200))
        assert envelope.contains(attitudes[:, 2]).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: from_elements(deg(97, 97), deg(149, 133)), "the minimum is above the maximum"),
        (lambda: from_elements(deg(97, 197), deg(0, 1)), "inclination is out of range"),
        (lambda: from_elements((float("nan"), 1.0), deg(0, 1)), "is not a number"),
        (lambda: AttitudeLimits("sunsat", deg(10, -10)), "roll: the minimum is above the maximum"),
        (lambda: AttitudeLimits("sunsat", yaw_rad=deg(0, 400)), "more than 360° apart"),
        (lambda: AttitudeLimits("sideways"), "unknown pointing law"),
        (lambda: AttitudeLimits("zenith", body_from_cam=(1.0,) * 9), "the mounting is not a rotation"),
    ],
)
def test_invalid_limits_are_rejected(make, message):
    """Each kind of invalid input raises BadInput with the reason."""
    with pytest.raises(BadInput, match=message):
        make()


def test_a_mounting_that_mirrors_is_rejected():
    """A reflection has orthogonal rows of unit length but is not a rotation, and is rejected."""
    with pytest.raises(BadInput, match="is a reflection, not a rotation"):
        AttitudeLimits("zenith", body_from_cam=(1.0, 0, 0, 0, 1.0, 0, 0, 0, -1.0))
    assert AttitudeLimits("zenith", body_from_cam=(1.0, 0, 0, 0, -1.0, 0, 0, 0, -1.0)).cam_from_body[2, 2] == -1

"""Frames: the roll convention is that of the public solvers; Sunsat's orbit axes are Jacobs'."""

from __future__ import annotations

import numpy as np
import pytest

from gss.domain.angles import ra_dec_from_unit, unit_from_ra_dec
from gss.domain.frames import cam_from_icrs, orbit_from_icrs, pointing_difference_rad, ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_from_vector, rotation_x, rotation_z

# Two reference attitudes fitted by public solvers: ra, dec, roll in degrees, and the first and third row of R_cam_from_icrs.
REFERENCE = [
    ((56.3473, 30.74085, 42.7706), (0.80340824, -0.11785884, -0.58364758), (0.47629174, 0.71544808, 0.51115577)),
    ((42.45377, 45.80069, 285.8156), (-0.32496966, -0.66668538, 0.67076473), (0.51437752, 0.47057717, 0.71691903)),
]


@pytest.mark.parametrize(("angles_deg", "x_axis", "boresight"), REFERENCE)
def test_roll_is_north_counter_clockwise_from_image_up(angles_deg, x_axis, boresight):
    """The matrix of (ra, dec, roll) is that of the public solvers' fit."""
    m = cam_from_icrs(*np.radians(angles_deg))
    assert np.allclose(m[0], x_axis, atol=2e-6)
    assert np.allclose(m[2], boresight, atol=2e-6)


def test_angles_and_matrix_are_inverse_at_random_and_at_the_poles():
    """ra, dec and roll reproduce the matrix, also at a pole, where ra is arbitrary."""
    rng = np.random.default_rng(6)
    matrices = [matrix_from_quaternion(random_quaternion(rng)) for _ in range(200)]
    matrices += [cam_from_icrs(1.0, np.pi / 2, 0.5), cam_from_icrs(4.0, -np.pi / 2, 2.5)]
    for m in matrices:
        assert np.allclose(cam_from_icrs(*ra_dec_roll_rad(m)), m, atol=1e-9)
        assert np.linalg.det(m) == pytest.approx(1)


def test_pointing_difference_splits_across_and_about_the_boresight():
    """A small rotation about x or y is a cross-boresight difference; a rotation about z is one about the boresight."""
    base = cam_from_icrs(1.0, 0.5, 0.2)
    cross, about = pointing_difference_rad(rotation_from_vector(np.array([3e-4, 4e-4, 0])) @ base, base)
    assert cross == pytest.approx(5e-4, rel=1e-6)
    assert about == pytest.approx(0, abs=1e-7)
    cross, about = pointing_difference_rad(rotation_z(1e-3) @ base, base)
    assert cross == pytest.approx(0, abs=1e-12)
    assert abs(about) == pytest.approx(1e-3, rel=1e-6)


@pytest.mark.parametrize(("inclination_deg", "declination_deg"), [(0, -90), (90, 0), (97, 7)])
def test_sunsats_boresight_lies_where_jacobs_says_for_every_place_in_the_orbit(inclination_deg, declination_deg):
    """Jacobs 1995 §5.2.1: with yaw 135° the boresight declination depends on the inclination only."""
    body_from_ss = rotation_z(np.radians(-45)) @ rotation_x(np.pi)
    for latitude_rad in np.linspace(0, 2 * np.pi, 7):
        orbit = orbit_from_icrs(0.7, np.radians(inclination_deg), latitude_rad)
        icrs_from_ss = orbit.T @ rotation_z(np.radians(135)).T @ body_from_ss
        boresight = icrs_from_ss @ np.array([0, 1, 0])
        assert np.degrees(ra_dec_from_unit(boresight)[1]) == pytest.approx(declination_deg, abs=1e-6)


def test_orbit_axes_are_a_right_handed_frame_with_z_down():
    """+z points to nadir, +x along the velocity and +y against the orbit normal."""
    m = orbit_from_icrs(0.3, 1.2, 2.0)
    assert np.allclose(m @ m.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(m) == pytest.approx(1)
    normal = np.array([np.sin(0.3) * np.sin(1.2), -np.cos(0.3) * np.sin(1.2), np.cos(1.2)])
    assert np.allclose(m[1], -normal, atol=1e-15)
    assert unit_from_ra_dec(0.3, 0.0) @ orbit_from_icrs(0.3, 1.2, 0.0)[2] == pytest.approx(-1)

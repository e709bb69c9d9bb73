"""Camera geometry: exact in both directions, and equal to the published formulas and FITS WCS."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.domain.angles import ra_dec_from_unit, unit_from_ra_dec
from gss.domain.camera import Brown, BrownUndistort, Camera, Pinhole, RadialTilt
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera, shipped_registry


@pytest.mark.parametrize("name", sorted(shipped_registry().cameras()))
def test_projection_is_exact_both_ways_for_every_profile(name):
    """Conversion of pixels to unit vectors and back is exact within 1e-9 px over the complete detector."""
    camera = shipped_camera(name).camera
    cols, rows = np.meshgrid(np.linspace(0, camera.columns - 1, 25), np.linspace(0, camera.rows - 1, 25))
    pixels = np.column_stack([cols.ravel(), rows.ravel()])
    assert np.abs(camera.project(camera.unproject(pixels)) - pixels).max() < 1e-9


@settings(max_examples=60, deadline=None)
@given(k1=st.floats(-0.35, 0.35), k2=st.floats(-0.1, 0.15), p1=st.floats(-0.01, 0.01), p2=st.floats(-0.01, 0.01))
def test_brown_inverse_undoes_any_moderate_lens(k1, k2, p1, p2):
    """Newton's inverse is exact wherever the polynomial is monotonic."""
    model = Brown(k1, k2, p1, p2)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ideal = 0.45 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert np.abs(model.undistort(model.distort(ideal)) - ideal).max() < 1e-11


def test_brown_follows_the_published_formula():
    """The model equals the formula on OpenCV's calibration page, evaluated here for one point."""
    x, y, k1, k2, p1, p2, k3 = 0.3, -0.2, -0.3, 0.1, 0.004, -0.006, 0.02
    r2 = 0.13
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    expected = (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )
    assert np.allclose(Brown(k1, k2, p1, p2, k3).distort(np.array([[x, y]]))[0], expected, atol=1e-15)


def test_inverted_signs_are_only_an_approximation():
    """Erlank's undistortion with inverted signs is wrong by 5 to 40 pixels at the corner, as the errata state."""
    camera = shipped_camera("cubestar").camera
    exact: Brown = camera.distortion
    approximate = BrownUndistort(-exact.k1, -exact.k2, -exact.p1, -exact.p2)
    corner = (np.array([[0.0, 0.0]]) - [camera.centre_col_px, camera.centre_row_px]) / camera.focal_col_px
    gap_px = np.linalg.norm(approximate.undistort(corner) - exact.undistort(corner)) * camera.focal_col_px
    assert 5 < gap_px < 40


def test_tilted_detector_follows_jacobs_formula():
    """The model equals Jacobs 1995 eq. 6.13 with 6.14 and 6.16, evaluated here in millimetres for one point."""
    f, theta_max, phi_max, k = 25.0, np.radians(0.733), np.radians(306), (1e-3, -8e-5, -4.4e-4)
    u, v = 1.9, -1.1
    r, phi = np.hypot(u, v), np.arctan2(v, u)
    theta = np.arcsin(np.sin(theta_max) * np.cos(phi - phi_max))
    lens = k[0] * r + k[1] * r**2 + k[2] * r**3
    r_true = np.cos(theta) * (r - lens) / (1 + r / f * np.sin(theta))
    ours = RadialTilt(f, theta_max, phi_max, k).undistort(np.array([[u / f, v / f]]))[0] * f
    assert np.allclose(ours, [r_true * np.cos(phi), r_true * np.sin(phi)], atol=1e-14)


def test_tilt_alone_is_the_perspective_of_a_tilted_plane():
    """Without a lens term, the tilt model equals independent ray tracing onto a tilted plane, to second order in tilt."""
    tilt = np.radians(0.733)
    model = RadialTilt(25.0, tilt, 0.0, ())
    ideal = np.array([[0.05, 0.0], [-0.05, 0.0], [0.0, 0.05]])
    # Plane through (0, 0, 1) with its +x edge further from the lens by the tilt.
    along = np.array([np.cos(tilt), 0, np.sin(tilt)])
    normal = np.array([-np.sin(tilt), 0, np.cos(tilt)])
    rays = np.column_stack([ideal, np.ones(3)])
    points = rays * (normal[2] / (rays @ normal))[:, None]
    traced = np.column_stack([(points - [0, 0, 1]) @ along, points[:, 1]])
    assert np.abs(model.distort(ideal) - traced).max() < 0.05 * tilt**2


def test_pinhole_is_the_gnomonic_projection_of_fits():
    """A FITS TAN projection of the same attitude gives the same sky position for each pixel (FITS counts from 1)."""
    camera = Camera(1024, 768, 5000.0, 5200.0, 500.3, 400.7)
    ra, dec, roll = np.radians([56.3, 30.7, 42.8])
    m = cam_from_icrs(ra, dec, roll)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval = ["RA---TAN", "DEC--TAN"], np.degrees([ra, dec])
    wcs.wcs.crpix = [camera.centre_col_px + 1, camera.centre_row_px + 1]
    c, s = np.cos(roll), np.sin(roll)
    east_north_from_cam = np.array([[-c, s], [-s, -c]])
    wcs.wcs.cd = np.degrees(east_north_from_cam @ np.diag([1 / camera.focal_col_px, 1 / camera.focal_row_px]))
    pixels = np.random.default_rng(7).uniform(0, 700, (100, 2))
    ours = np.degrees(ra_dec_from_unit(camera.unproject(pixels) @ m))
    theirs = wcs.wcs_pix2world(pixels, 0).T
    assert np.abs(ours - theirs).max() < 1e-10


def test_fields_of_view_are_those_of_the_documents():
    """The fields of view are Jacobs 11.17° x 8.32°, Huffman 30.06° x 24.25°, Moniteq 3.45° and, without distortion,
    CubeStar 49.1° x 25.7°."""
    fov = {name: np.degrees(p.camera.fov_rad) for name, p in shipped_registry().cameras().items()}
    assert fov["sunsat"] == pytest.approx((11.17, 8.32), abs=0.03)
    assert fov["far_mst"] == pytest.approx((30.06, 24.25), abs=0.01)
    assert fov["aim"] == pytest.approx((3.45, 3.45), abs=0.001)
    cubestar = shipped_camera("cubestar").camera
    ideal = Camera(1024, 512, cubestar.focal_col_px, cubestar.focal_row_px, 511.5, 255.5, Pinhole())
    assert np.degrees(ideal.fov_rad) == pytest.approx((49.1, 25.7), abs=0.1)


def test_stars_behind_the_camera_have_no_position():
    """Projection of a direction behind the image plane is NaN, and NaN is not on the detector."""
    camera = shipped_camera("cubestar").camera
    pixels = camera.project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]))
    assert camera.contains(pixels).tolist() == [False, True]


def test_impossible_cameras_are_rejected_with_a_message():
    """A camera with zero columns and a field of view of 180° are rejected."""
    with pytest.raises(BadInput, match="at least 1 x 1"):
        Camera(0, 10, 1, 1, 0, 0)
    with pytest.raises(BadInput, match="between 0° and 180°"):
        Camera.from_fov(100, 100, np.pi)


def test_diagonal_bounds_every_pair_on_the_detector():
    """No two directions on the detector are further apart than the diagonal."""
    for p in shipped_registry().cameras().values():
        outline = p.camera.outline(20)
        widest = np.arccos(np.clip(outline @ outline.T, -1, 1)).max()
        assert widest <= p.camera.diagonal_rad + 1e-9


def test_unit_vectors_point_where_the_sky_is():
    """At roll 0, east is at lower columns and north at lower rows: the image is not mirrored."""
    camera = Camera.from_fov(1000, 1000, 0.2)
    m = cam_from_icrs(1.0, 0.3, 0.0)
    east = camera.project((unit_from_ra_dec(1.01, 0.3) @ m.T)[None])[0]
    north = camera.project((unit_from_ra_dec(1.0, 0.31) @ m.T)[None])[0]
    assert east[0] < camera.centre_col_px - 10
    assert north[1] < camera.centre_row_px - 10

"""Sunsat's coordinates: exact inverses, handedness of the image, and the document's statements about the orbit. The
document's path over the detector plane is implemented here as printed; the chain uses the camera model instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.catalogue_tools.envelope.attitude import BODY_FROM_CAM as CATALOGUE_BODY_FROM_CAM
from gss.catalogue_tools.envelope.attitude import euler_123 as catalogue_euler_123
from gss.domain.angles import Array
from gss.domain.camera import Camera, RadialTilt
from gss.domain.errors import BadInput
from gss.domain.frames import orbit_from_icrs, ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_angle_rad
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.sunsat_frames import (
    BODY_FROM_CAM,
    SS_FROM_CAM,
    OrbitElements,
    attitude_angles_rad,
    cam_from_icrs_of,
    euler_123,
    orbit_from_celestial,
    roll_pitch_yaw_rad,
)

# §1.1: dummy and dark columns before the image, dummy and dark rows below it.
DUMMY_COLUMNS, DUMMY_ROWS = 25, 12


@dataclass(frozen=True)
class Plate:
    """The detector in millimetres. ``centre_*_px``: position of the optical axis in the project's pixel coordinates."""

    hunit_mm: float
    vunit_mm: float
    focal_mm: float
    centre_col_px: float
    centre_row_px: float

    @classmethod
    def of(cls, camera: Camera, focal_mm: float) -> Plate:
        """Return the plate of a camera whose lens has that focal length."""
        return cls(
            focal_mm / camera.focal_col_px,
            focal_mm / camera.focal_row_px,
            focal_mm,
            camera.centre_col_px,
            camera.centre_row_px,
        )

    @property
    def optical_centre_mm(self) -> tuple[float, float]:
        """Return (horoptcen, vertoptcen) of eq. 1.3."""
        h, v = self.horvert_from_pixels(np.array([[self.centre_col_px, self.centre_row_px]]))[0]
        return float(h), float(v)

    def horvert_from_pixels(self, pixels: Array) -> Array:
        """Return (n, 2) hor, vert in mm for (n, 2) pixels (col, row). In eq. 2.1–2.2 a pixel's centre is at column −
        0.5.
        """
        p = np.asarray(pixels, float) + 0.5 + np.array([DUMMY_COLUMNS, DUMMY_ROWS])
        return np.asarray(p * np.array([self.hunit_mm, self.vunit_mm]))

    def pixels_from_horvert(self, horvert_mm: Array) -> Array:
        """Return (n, 2) pixels; the inverse of :meth:`horvert_from_pixels`."""
        p = np.asarray(horvert_mm, float) / np.array([self.hunit_mm, self.vunit_mm])
        return np.asarray(p - 0.5 - np.array([DUMMY_COLUMNS, DUMMY_ROWS]))

    def uv_from_pixels(self, pixels: Array) -> Array:
        """Return (n, 2) measured u, v in mm (eq. 1.3)."""
        hor, vert = self.horvert_from_pixels(pixels).T
        hor_centre, vert_centre = self.optical_centre_mm
        return np.stack([hor_centre - hor, vert - vert_centre], axis=-1)

    def pixels_from_uv(self, uv_mm: Array) -> Array:
        """Return (n, 2) pixels; the inverse of :meth:`uv_from_pixels`."""
        u, v = np.asarray(uv_mm, float).T
        hor_centre, vert_centre = self.optical_centre_mm
        return self.pixels_from_horvert(np.stack([hor_centre - u, vert_centre + v], axis=-1))


def corrected_uv(uv_mm: Array, camera: Camera, focal_mm: float) -> Array:
    """Return (n, 2) u, v in mm, corrected for tilt and lens aberration (eq. 6.13–6.20) with the camera's distortion,
    whose axes are −u and +v in units of the focal length.
    """
    flip = np.array([-1.0, 1.0])
    return np.asarray(camera.distortion.undistort(np.asarray(uv_mm, float) * flip / focal_mm) * focal_mm * flip)


def ss_from_uv(uv_mm: Array, focal_mm: float) -> Array:
    """Return (n, 3) star sensor unit vectors of corrected (n, 2) u, v (``uvtoss``, eq. 1.4–1.6)."""
    u, v = np.moveaxis(np.asarray(uv_mm, float), -1, 0)
    phi = np.arctan2(u, focal_mm)
    lam = np.arctan2(v * np.cos(phi), focal_mm)
    return np.stack([-np.sin(phi) * np.cos(lam), np.cos(phi) * np.cos(lam), -np.sin(lam)], axis=-1)


def uv_from_ss(unit_ss: Array, focal_mm: float) -> Array:
    """Return (n, 2) u, v in mm of (n, 3) star sensor vectors (``sstouv``, eq. 1.7–1.9 without their arcsine); NaN
    behind the lens.
    """
    x, y, z = np.moveaxis(np.asarray(unit_ss, float), -1, 0)
    ahead = np.where(y > 0, y, np.nan)
    return np.stack([-focal_mm * x / ahead, -focal_mm * z / ahead], axis=-1)


CAMERA = shipped_camera("sunsat").camera
PLATE = Plate.of(CAMERA, 25.0)
RNG = np.random.default_rng(11)
PIXELS = RNG.uniform((-0.5, -0.5), (751.5, 581.5), (500, 2))


def test_plate_has_the_units_of_the_document() -> None:
    """The pixels measure 6.5 x 6.25 µm; the upper corner of the first light pixel is at (0.169, 0.08125) mm, and the
    middle of the detector at (2.6065, 1.89375) mm (Jacobs 1995 §1.1).
    """
    assert (PLATE.hunit_mm, PLATE.vunit_mm) == pytest.approx((0.0065, 0.00625), abs=1e-15)
    corner = PLATE.horvert_from_pixels(np.array([[0.5, 0.5]]))[0]
    np.testing.assert_allclose(corner, [0.169, 0.08125], atol=1e-12)
    middle = PLATE.horvert_from_pixels(np.array([[375.5, 290.5]]))[0]
    # The document calculates (25 + 376) x 0.0065 = 2.6065 and (12 + 291) x 0.00625 = 1.89375.
    np.testing.assert_allclose(middle, [2.6065, 1.89375], atol=1e-12)


def test_coordinate_transformations_have_exact_inverses() -> None:
    """The transformations from pixels to hor, vert, to u, v and to star sensor vectors are reversible within 1e-11 px.
    Vectors behind the lens give NaN.
    """
    restored = PLATE.pixels_from_horvert(PLATE.horvert_from_pixels(PIXELS))
    np.testing.assert_allclose(restored, PIXELS, atol=1e-11)
    uv = PLATE.uv_from_pixels(PIXELS)
    np.testing.assert_allclose(PLATE.pixels_from_uv(uv), PIXELS, atol=1e-11)
    np.testing.assert_allclose(uv_from_ss(ss_from_uv(uv, 25.0), 25.0), uv, atol=1e-14)
    assert np.isnan(uv_from_ss(np.array([[0.0, -1.0, 0.0]]), 25.0)).all()


def test_uv_path_agrees_with_the_camera_model() -> None:
    """The centroid in mm, the correction of tilt and lens (eq. 6.13–6.20) and eq. 1.6 give the direction of the camera
    model within 1e-14.
    """
    uv = corrected_uv(PLATE.uv_from_pixels(PIXELS), CAMERA, 25.0)
    np.testing.assert_allclose(ss_from_uv(uv, 25.0), CAMERA.unproject(PIXELS) @ SS_FROM_CAM.T, atol=1e-14)


def test_correction_agrees_with_equation_6_13() -> None:
    """The correction agrees with the equations as printed, with φ from +u to +v, for a tilted detector."""
    # φ from +u towards +v is 180° − the camera's angle from +x towards +y, because u = −x.
    camera = Camera(
        752, 582, 25 / 0.0065, 25 / 0.00625, 380.0, 300.0, RadialTilt(25.0, 0.013, 2.1, (1e-3, -8e-5, -4e-4))
    )
    u, v = np.array([1.3, -2.0, 0.4]), np.array([-0.7, 1.1, 1.6])
    r, phi, phi_max = np.hypot(u, v), np.arctan2(v, u), np.pi - 2.1
    theta = np.arcsin(np.sin(0.013) * np.cos(phi - phi_max))
    delta = 1e-3 * r - 8e-5 * r**2 - 4e-4 * r**3
    r_a = np.cos(theta) * (r - delta) / (1 + r / 25.0 * np.sin(theta))
    expected = np.stack([r_a * np.cos(phi), r_a * np.sin(phi)], axis=-1)
    np.testing.assert_allclose(corrected_uv(np.stack([u, v], axis=-1), camera, 25.0), expected, atol=1e-14)


def test_the_image_is_not_mirrored() -> None:
    """Three stars have the same handedness in the camera, star sensor and body frames. If v points upwards, as in the
    document's drawing of the detector from the front, the same pixels are mirrored.
    """
    triangle = np.array([[200.0, 150.0], [500.0, 180.0], [330.0, 420.0]])
    cam = CAMERA.unproject(triangle)
    ss = ss_from_uv(corrected_uv(PLATE.uv_from_pixels(triangle), CAMERA, 25.0), 25.0)
    body = cam @ BODY_FROM_CAM.T
    signs = [np.sign(np.linalg.det(v)) for v in (cam, ss, body)]
    assert signs == [signs[0]] * 3
    assert np.linalg.det(SS_FROM_CAM) == pytest.approx(1.0)
    v_upwards = triangle * [1, -1] + [0, 2 * PLATE.centre_row_px]
    flipped = ss_from_uv(PLATE.uv_from_pixels(v_upwards), 25.0)
    assert np.sign(np.linalg.det(flipped)) == -signs[0]


def test_mounting_and_euler_angles_agree_with_the_catalogue_tools() -> None:
    """The pipeline and the catalogue tools, which may not share code, have the same mounting matrix and the same Euler
    1-2-3 rotation.
    """
    np.testing.assert_allclose(BODY_FROM_CAM, CATALOGUE_BODY_FROM_CAM["sunsat"], atol=1e-15)
    angles = RNG.uniform(-3, 3, (50, 3))
    matrices = np.stack([euler_123(*a) for a in angles])
    np.testing.assert_allclose(matrices, catalogue_euler_123(angles), atol=1e-14)
    np.testing.assert_allclose(matrices[0].T, Rotation.from_euler("XYZ", angles[0]).as_matrix(), atol=1e-14)


def test_orbit_matrix_agrees_with_the_orbit_frame() -> None:
    """The four rotations of eq. 1.18 give the orbit axes of §1.4: nadir, velocity and the direction opposite to the
    orbit normal. Elements that are not finite are rejected.
    """
    for raan, i, latitude in RNG.uniform(0, 6, (50, 3)):
        expected = orbit_from_icrs(raan, i, latitude)
        np.testing.assert_allclose(orbit_from_celestial(raan, i, latitude), expected, atol=1e-14)
    with pytest.raises(BadInput, match="finite"):
        OrbitElements(np.nan, 0.0, 0.0)


@pytest.mark.parametrize(("inclination", "declination"), [(0, -90), (90, 0), (97, 7)])
def test_boresight_has_the_declination_of_the_document(inclination: float, declination: float) -> None:
    """With a yaw of 135°, inclinations of 0°, 90° and 97° give a boresight at Dec −90°, 0° and +7° at every latitude of
    the orbit (§5.2.1).
    """
    for latitude in np.radians([0, 77, 190, 300]):
        orbit = OrbitElements(1.0, np.radians(inclination), latitude)
        _, dec, _ = ra_dec_roll_rad(cam_from_icrs_of(orbit, 0.0, 0.0, np.radians(135)))
        assert np.degrees(dec) == pytest.approx(declination, abs=1e-6)


def test_roll_pitch_yaw_restore_the_attitude() -> None:
    """The angles of any attitude restore it, also beyond the ±90° of the document's arcsines. Within ±90° they equal
    those of eqs. 4.17–4.19.
    """
    for _ in range(200):
        matrix = matrix_from_quaternion(random_quaternion(RNG))
        assert rotation_angle_rad(euler_123(*roll_pitch_yaw_rad(matrix)), matrix) < 1e-12
    roll, pitch, yaw = np.radians([8.0, -4.0, 135.0])
    matrix_of_angles = euler_123(roll, pitch, yaw)
    assert roll_pitch_yaw_rad(matrix_of_angles) == pytest.approx((roll, pitch, yaw), abs=1e-14)
    assert np.arcsin(matrix_of_angles[2, 0]) == pytest.approx(pitch, abs=1e-14)
    assert np.arcsin(-matrix_of_angles[2, 1] / np.cos(pitch)) == pytest.approx(roll, abs=1e-14)
    assert np.pi - np.arcsin(-matrix_of_angles[1, 0] / np.cos(pitch)) == pytest.approx(yaw, abs=1e-14)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_attitude_at_gimbal_lock_is_restored(pitch: float) -> None:
    """At a pitch of ±90°, roll and yaw are the same rotation. Yaw is set to zero, and the angles restore the attitude."""
    matrix = euler_123(0.4, pitch, 0.7)
    angles = roll_pitch_yaw_rad(matrix)
    assert angles[2] == 0.0
    assert rotation_angle_rad(euler_123(*angles), matrix) < 1e-7


def test_angles_over_an_orbit_are_recovered() -> None:
    """Roll, pitch and yaw of a camera attitude over an orbit are the angles from which the attitude was calculated."""
    orbit = OrbitElements(2.0, np.radians(97), 4.0)
    angles = tuple(np.radians([3.0, -2.0, 131.0]))
    assert attitude_angles_rad(cam_from_icrs_of(orbit, *angles), orbit) == pytest.approx(angles, abs=1e-12)

"""Principal point from rendered pictures through a second lens, compared with the camera that took them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.sensor import Sensor
from gss.instruments.registry import shipped_camera
from gss.pipeline.calibration.light_circle import circle_of_light, principal_point
from gss.pipeline.second_lens import SecondLens, common_area, through_second_lens

CAMERAS = ("cubestar", "sunsat", "far_mst", "oersted", "aim")


def decentred(name: str, col_px: float, row_px: float) -> tuple[Camera, Sensor]:
    """Return the camera of a package with its principal point displaced, and its sensor."""
    profile = shipped_camera(name)
    centre = profile.camera.centre_col_px + col_px, profile.camera.centre_row_px + row_px
    return replace(profile.camera, centre_col_px=centre[0], centre_row_px=centre[1]), profile.sensor


def take_picture(camera: Camera, sensor: Sensor, lens: SecondLens, seed: int) -> np.ndarray:
    """Return the light-sensitive pixels of a picture through a second lens."""
    picture = through_second_lens(camera, sensor, lens, np.random.default_rng(seed))
    return np.asarray(sensor.dark_columns.split(picture, camera.columns)[0])


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("ratio", [0.05, 0.2, 0.5])
def test_a_decentred_principal_point_is_recovered_within_its_interval(name: str, ratio: float) -> None:
    """The centre of the circle is the principal point of the camera within 3 σ per axis and 1 px, also if the edge of
    the detector cuts the circle and if the lens has tangential distortion or a tilted detector.
    """
    camera, sensor = decentred(name, 23.4, -11.7)
    point = principal_point([take_picture(camera, sensor, SecondLens(ratio), 7)])
    error = np.array([point.col_px - camera.centre_col_px, point.row_px - camera.centre_row_px])
    assert (np.abs(error) < 3 * point.sigma_px).all()
    assert np.hypot(*error) < 1.0
    assert point.sigma_px < 1.0
    assert "one-lens-position" in {w.code for w in point.warnings}


def test_a_turned_second_lens_removes_its_decentring() -> None:
    """A decentred second lens moves the circle of one picture by focal length times ratio times displacement. The mean
    of three pictures with the lens turned by 120° is the principal point within 3 σ, and σ contains the scatter.
    """
    camera, sensor = decentred("far_mst", -14.0, 9.0)
    off = [0.05 * np.array([np.cos(a), np.sin(a)]) for a in (0.3, 0.3 + 2 * np.pi / 3, 0.3 + 4 * np.pi / 3)]
    pictures = [
        take_picture(camera, sensor, SecondLens(0.2, (float(x), float(y))), seed) for seed, (x, y) in enumerate(off)
    ]
    expected_px = camera.focal_col_px * 0.2 * 0.05
    one = circle_of_light(pictures[0])
    assert np.hypot(one.col_px - camera.centre_col_px, one.row_px - camera.centre_row_px) == pytest.approx(
        expected_px, rel=0.05
    )
    point = principal_point(pictures)
    assert np.hypot(point.col_px - camera.centre_col_px, point.row_px - camera.centre_row_px) < 0.2
    assert point.scatter_px == pytest.approx(expected_px * np.sqrt(3 / 4), rel=0.05)
    assert point.sigma_px == pytest.approx(point.scatter_px / np.sqrt(3), rel=1e-6)
    assert "one-lens-position" not in {w.code for w in point.warnings}


def test_uneven_light_is_reported_and_removed_by_turning_the_lamp() -> None:
    """Light that is 30 % stronger on one side displaces the circle of one picture by more than 5 px and gives a warning.
    If the lamp turns with the second lens, the mean of three pictures is the principal point within 3 σ and 1 px.
    """
    camera, sensor = decentred("far_mst", 0.0, 0.0)
    picture = take_picture(camera, sensor, SecondLens(0.2), 1).astype(float)
    row, col = np.indices(picture.shape)
    x, y = (col - camera.centre_col_px) / 440, (row - camera.centre_row_px) / 440
    angles = np.arange(3) * 2 * np.pi / 3
    pictures = [picture * (1 + 0.3 * (x * np.cos(a) + y * np.sin(a))) for a in angles]
    one = principal_point(pictures[:1])
    assert one.col_px - camera.centre_col_px > 5
    assert "uneven-light" in {w.code for w in one.warnings}
    point = principal_point(pictures)
    error_px = float(np.hypot(point.col_px - camera.centre_col_px, point.row_px - camera.centre_row_px))
    assert error_px < min(1.0, 3 * point.sigma_px)


def test_pictures_without_a_circle_of_light_are_rejected() -> None:
    """A dark picture, an even picture, a circle at the edge, a single bright pixel and pictures of two sizes raise
    BadInput.
    """
    rng = np.random.default_rng(1)
    dark = rng.normal(10, 2, (256, 320))
    row, col = np.indices(dark.shape)
    at_edge = dark + 200 * np.clip(1 - np.hypot(col - 2, row - 120) / 60, 0, 1)
    spot = dark.copy()
    spot[100, 100] += 5000
    for picture in (dark, dark + 100, at_edge, spot, np.full((256, 320), np.nan), dark[:20, :20]):
        with pytest.raises(BadInput):
            principal_point([picture])
    with pytest.raises(BadInput, match="the same size"):
        principal_point([dark, dark[:, :300]])
    with pytest.raises(BadInput, match="same size"):
        principal_point([])


def test_the_common_area_of_the_pupils_is_that_of_two_circles() -> None:
    """The formula agrees with a count of points within 0.3 % of the area of a pupil, and is zero from one diameter on."""
    side = (np.arange(1200) + 0.5) / 1200 - 0.5
    x, y = np.meshgrid(side, side)
    first = np.hypot(x, y) < 0.5
    for distance in (0.0, 0.2, 0.6, 0.9):
        counted = (first & (np.hypot(x - distance, y) < 0.5)).sum() / first.sum()
        assert common_area(np.array([distance]))[0] == pytest.approx(counted, abs=3e-3)
    assert common_area(np.array([1.0, 1.7])).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("lens", [SecondLens(0.0), SecondLens(5.0), SecondLens(0.2, (1.0, 0.5)), SecondLens(np.nan)])
def test_impossible_second_lenses_are_rejected(lens: SecondLens) -> None:
    """A ratio of zero or more than 2 and a lens beside the camera raise BadInput."""
    camera, sensor = decentred("aim", 0.0, 0.0)
    with pytest.raises(BadInput):
        through_second_lens(camera, sensor, lens, np.random.default_rng(1))

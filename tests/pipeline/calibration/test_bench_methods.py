"""Calibration from dots, star pairs, polynomials and checkerboards, compared with the cameras that produced the data."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.domain.camera import Brown, Camera, RadialTilt
from gss.domain.camera_profile import CameraProfile
from gss.domain.camera_record import camera_from, record_of
from gss.domain.errors import BadInput, CorruptData
from gss.pipeline.calibration import checkerboard
from gss.pipeline.calibration.checkerboard import calibrate_checkerboard
from gss.pipeline.calibration.dots import detector_tilt, optical_centre
from gss.pipeline.calibration.focal_pairs import focal_from_pair, focal_from_pairs
from gss.pipeline.calibration.focus import best_focus
from gss.pipeline.calibration.plain_values import as_record
from gss.pipeline.calibration.radial import radial_polynomial
from gss.pipeline.calibration.sightings import FrameStars

ProfileOf = Callable[[str], CameraProfile]
StarFrames = Callable[..., list[FrameStars]]
needs_opencv = pytest.mark.skipif(
    importlib.util.find_spec("cv2") is None,
    reason='OpenCV is not installed: pip install "gss-startracker[checkerboard]"',
)


def _positions_of_rotated_dot(
    camera: Camera, direction: tuple[float, float], turns: int, play_px: float, seed: int
) -> np.ndarray:
    """Return the image positions of a dot while the camera rotates about its axis. ``direction`` holds the tangents of
    the dot's direction; ``play_px`` is the standard deviation of the clamp's play.
    """
    rng = np.random.default_rng(seed)
    x, y = direction
    angles = np.arange(turns) * 2 * np.pi / turns
    c, s = np.cos(angles), np.sin(angles)
    unit = np.column_stack([c * x - s * y, s * x + c * y, np.ones(turns)])
    return camera.project(unit / np.linalg.norm(unit, axis=1, keepdims=True)) + play_px * rng.normal(size=(turns, 2))


def test_optical_centre_is_the_centre_of_the_circle_of_a_dot(profile_of: ProfileOf) -> None:
    """A circle of 15 px with 0.2 px of play gives the true centre within five σ, and σ is below 0.1 px."""
    camera = profile_of("cubestar").camera
    shifted = replace(camera, centre_col_px=540.3, centre_row_px=240.8)
    centre = optical_centre(_positions_of_rotated_dot(shifted, (0.013, 0.004), 36, 0.2, 1))
    assert centre.circle
    assert centre.radius_px == pytest.approx(15.2, abs=0.3)
    assert np.hypot(centre.col_px - 540.3, centre.row_px - 240.8) < 5 * centre.sigma_px
    assert centre.sigma_px < 0.1
    assert centre.warnings == ()


def test_centre_of_a_jumping_dot_is_the_middle_of_its_box(profile_of: ProfileOf) -> None:
    """If the play exceeds the circle, as in Jacobs' Fig. F-2, the centre is the middle of the dot's bounding box,
    within 3 px. A quarter of a circle and widely scattered dots give warnings; three positions are rejected.
    """
    camera = profile_of("sunsat").camera
    centre = optical_centre(_positions_of_rotated_dot(camera, (0.0002, 0.0), 36, 2.5, 2))
    assert not centre.circle
    assert max(centre.box_px) < 16
    assert abs(centre.col_px - camera.centre_col_px) < 3
    assert abs(centre.row_px - camera.centre_row_px) < 3
    quarter = _positions_of_rotated_dot(camera, (0.003, 0.0), 36, 0.1, 2)[:9]
    assert "one-part" in {w.code for w in optical_centre(quarter).warnings}
    assert "far-dot" in {w.code for w in optical_centre(np.random.default_rng(1).normal(0, 20, (36, 2))).warnings}
    with pytest.raises(BadInput, match="positions of a dot"):
        optical_centre(np.zeros((3, 2)))


def _centre_errors_and_sigma(turns_rad: np.ndarray, radius_px: float, play_px: float) -> tuple[np.ndarray, float]:
    """Return the (2,) rms errors of the optical centre of 200 simulated rotations, and the median of its σ."""
    rng = np.random.default_rng(11)
    truth_px = np.array([800.0, 600.0])
    circle_px = truth_px + radius_px * np.column_stack([np.cos(turns_rad), np.sin(turns_rad)])
    centres = [optical_centre(circle_px + play_px * rng.normal(size=circle_px.shape)) for _ in range(200)]
    errors = np.array([(c.col_px, c.row_px) for c in centres]) - truth_px
    return np.sqrt(np.mean(errors**2, axis=0)), float(np.median([c.sigma_px for c in centres]))


@pytest.mark.parametrize(
    ("turns", "arc_deg", "radius_px"),
    [(36, 360, 0.0), (6, 360, 50.0), (36, 360, 50.0), (12, 180, 50.0), (12, 130, 50.0)],
)
def test_sigma_of_the_optical_centre_is_its_error(turns: int, arc_deg: float, radius_px: float) -> None:
    """The stated σ agrees with the larger error of the two axes, for a dot without a circle far from pixel (0, 0),
    for few positions and for a part of the circle.
    """
    angles_rad = np.radians(np.linspace(0, arc_deg, turns, endpoint=arc_deg < 360))
    errors, sigma = _centre_errors_and_sigma(angles_rad, radius_px, play_px=0.3 if radius_px else 3.0)
    assert sigma / errors.max() == pytest.approx(1, abs=0.2)


def test_tilt_is_fitted_to_pairs_of_spots(profile_of: ProfileOf) -> None:
    """36 pairs with an error of 0.02 px give Jacobs' tilt of 0.733° and its direction within 3.5 σ. A detector without
    tilt gives a warning.
    """
    profile = profile_of("sunsat")
    lens = profile.camera.distortion
    assert isinstance(lens, RadialTilt)
    camera = replace(profile.camera, distortion=RadialTilt(25.0, lens.tilt_max_rad, lens.tilt_direction_rad))
    inner, outer = (
        _positions_of_rotated_dot(camera, (0.0, 0.0), 36, 0.02, 3),
        _positions_of_rotated_dot(camera, (0.06, 0.0), 36, 0.02, 4),
    )
    tilt = detector_tilt(inner, outer, profile.camera, 25.0)
    assert np.degrees(tilt.tilt_max_rad) == pytest.approx(0.733, abs=0.08)
    assert abs(tilt.tilt_max_rad - lens.tilt_max_rad) < 3.5 * tilt.sigma_rad[0]
    direction_error = (tilt.tilt_direction_rad - lens.tilt_direction_rad + np.pi) % (2 * np.pi) - np.pi
    assert abs(direction_error) < 3.5 * tilt.sigma_rad[1]
    assert tilt.radius_mm == pytest.approx(1.5, abs=0.01)
    assert tilt.rms_mm == pytest.approx(0.02 * np.sqrt(2) * 0.0064, rel=0.4)
    untilted = replace(profile.camera, distortion=RadialTilt(25.0))
    without_tilt = detector_tilt(
        _positions_of_rotated_dot(untilted, (0, 0), 36, 0.3, 5),
        _positions_of_rotated_dot(untilted, (0.06, 0), 36, 0.3, 6),
        untilted,
        25.0,
    )
    assert {w.code for w in without_tilt.warnings} == {"no-tilt"}
    with pytest.raises(BadInput, match="numbers of inner and outer dots"):
        detector_tilt(inner, outer[:30], profile.camera, 25.0)


def test_focal_length_of_one_pair_is_exact() -> None:
    """The solution of eq. 6.4 is the focal length of the camera that saw the pair, however close the two stars are. It
    is NaN if no camera can have seen the pair.
    """
    rng = np.random.default_rng(4)
    for max_tangent in (0.3, 0.01, 0.0003):
        for _ in range(20):
            a, b = rng.uniform(-max_tangent, max_tangent, (2, 2)) * 25.0
            va, vb = (np.append(p, 25.0) / np.linalg.norm(np.append(p, 25.0)) for p in (a, b))
            angle = 2 * np.arcsin(np.linalg.norm(va - vb) / 2)
            assert focal_from_pair(a, b, float(angle)) == pytest.approx(25.0, rel=1e-6)
    assert np.isnan(focal_from_pair(np.zeros(2), np.zeros(2), 0.1))


def test_focal_length_is_the_root_of_the_printed_equation() -> None:
    """The focal length is the root of eq. 6.4–6.6 with the printed coefficients a, b and c."""
    (u1, v1), (u2, v2), theta = (1.1, -0.4), (-0.7, 0.9), 0.0886
    sec2 = 1 / np.cos(theta) ** 2
    a = sec2 - 1
    b = 2 * (u1 * u2 + v1 * v2) * sec2 - u1**2 - v1**2 - u2**2 - v2**2
    c = (u1 * u2 + v1 * v2) ** 2 * sec2 - u1**2 * u2**2 - u1**2 * v2**2 - v1**2 * u2**2 - v1**2 * v2**2
    f = np.sqrt((-b + np.sqrt(b * b - 4 * a * c)) / (2 * a))
    assert focal_from_pair(np.array([u1, v1]), np.array([u2, v2]), theta) == pytest.approx(f, rel=1e-9)


def test_focal_length_is_found_from_star_pairs_of_many_frames(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """FAR-MST's focal length is found within 0.05 % and 4 σ. Erlank's small-angle form agrees within 2 %. Distortion
    gives a warning, and too few pairs are rejected.
    """
    camera = profile_of("far_mst").camera
    estimate = focal_from_pairs(star_frames(camera, limit_mag=5.5), camera.with_focal_scaled(1.03))
    focal = camera.focal_col_px
    assert estimate.focal_px == pytest.approx(focal, rel=5e-4)
    assert abs(estimate.focal_px - focal) < 4 * estimate.sigma_px
    assert estimate.erlank_px == pytest.approx(focal, rel=0.02)
    distorted = replace(camera, distortion=Brown(-0.3))
    assert {
        w.code for w in focal_from_pairs(star_frames(distorted, limit_mag=5.5), camera, radius_px=800).warnings
    } == {"distortion"}
    with pytest.raises(BadInput, match="too few pairs"):
        focal_from_pairs(star_frames(camera, frames=2), camera, radius_px=5.0)


def test_polynomial_in_millimetres_is_recovered(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """With known tilt and centre, Jacobs' Δr (F.9) is recovered to 1.2 µm over the whole detector."""
    profile = profile_of("sunsat")
    lens = profile.camera.distortion
    assert isinstance(lens, RadialTilt)
    frames = star_frames(profile.camera, frames=60, limit_mag=8.0, sigma_px=0.05, max_stars=200)
    start = replace(profile.camera, distortion=replace(lens, radial=()))
    polynomial = radial_polynomial(frames, start, 25.0)
    r = np.linspace(0.2, 2.8, 20)

    def delta(k: np.ndarray) -> np.ndarray:
        return sum(c * r ** (i + 1) for i, c in enumerate(k))

    error_mm = delta(polynomial.coefficients) - delta(np.array(lens.radial))
    assert np.abs(error_mm).max() < 1.2e-3
    assert polynomial.frames >= 20
    assert polynomial.rms_mm == pytest.approx(0.05 * np.sqrt(2) * 0.0064, rel=0.35)
    with pytest.raises(BadInput, match="near the optical centre"):
        radial_polynomial(frames[:1], start, 25.0, near_mm=0.001)


def _rays(camera: Camera, subpixels: int) -> np.ndarray:
    """Return (n, 3) directions through ``subpixels`` x ``subpixels`` points of every pixel."""
    step = (np.arange(subpixels) - (subpixels - 1) / 2) / subpixels
    col = (np.arange(camera.columns)[:, None] + step).ravel()
    row = (np.arange(camera.rows)[:, None] + step).ravel()
    c, r = np.meshgrid(col, row)
    return camera.unproject(np.column_stack([c.ravel(), r.ravel()]))


def _board(
    rays: np.ndarray, camera: Camera, rotation: Rotation, board_centre_mm: np.ndarray, square_mm: float
) -> np.ndarray:
    """Return an image of a board of 9 x 7 squares with a white rim; each ray is followed to the board."""
    board_axes = rotation.as_matrix()
    scale = (board_axes[:, 2] @ board_centre_mm) / (rays @ board_axes[:, 2])
    on_board = (rays * scale[:, None] - board_centre_mm) @ board_axes
    x, y = on_board[:, 0] / square_mm + 4.5, on_board[:, 1] / square_mm + 3.5
    inside = (x >= 0) & (y >= 0) & (x < 9) & (y < 7)
    dark = inside & ((np.floor(x) + np.floor(y)) % 2 == 0)
    rim = (x >= -1) & (y >= -1) & (x < 10) & (y < 8)
    light = np.where(dark, 25.0, np.where(rim, 220.0, 110.0))
    subpixels = round(np.sqrt(len(rays) / (camera.rows * camera.columns)))
    return light.reshape(camera.rows, subpixels, camera.columns, subpixels).mean(axis=(1, 3))


@needs_opencv
def test_checkerboard_gives_the_camera_that_rendered_it() -> None:
    """Every parameter is within four σ, the focal length within 1.5 %, and the corners fit within 0.1 px rms. An image
    without a board is not used; too few images and unequal sizes are rejected.
    """
    camera = Camera(320, 240, 350.0, 352.0, 163.0, 117.0, Brown(-0.25, 0.08, 0.002, -0.001))
    rng, images, rays = np.random.default_rng(3), [], _rays(camera, 3)
    board_centres_mm = [
        (-55, -45),
        (50, -45),
        (-55, 40),
        (50, 40),
        (0, 0),
        (-30, 20),
        (40, 0),
        (0, -40),
        (-60, 0),
        (20, 40),
    ]
    for k, (x, y) in enumerate(board_centres_mm):
        tilt = Rotation.from_euler("yxz", [0.45 * np.cos(2.4 * k), 0.45 * np.sin(2.4 * k), 0.2 * np.sin(k)])
        picture = _board(rays, camera, tilt, np.array([x, y, 330.0 + 15 * (k % 3)]), 14.0)
        images.append(np.clip(picture + 2 * rng.normal(size=picture.shape), 0, 255).astype(np.uint8))
    calibration = calibrate_checkerboard([*images, np.full((240, 320), 90, np.uint8)], (8, 6), 14.0)
    assert calibration.found.count(True) >= 8
    assert not calibration.found[-1]
    assert np.isnan(calibration.rms_px[-1])
    assert calibration.residual_rms_px < 0.1
    truth = (350.0, 352.0, 163.0, 117.0, -0.25, 0.08, 0.002, -0.001)
    for value, sigma, true in zip(calibration.values, calibration.sigma, truth, strict=False):
        assert abs(value - true) < 4 * sigma
    assert calibration.camera.focal_col_px == pytest.approx(350.0, rel=0.015)
    assert abs(calibration.camera.centre_row_px - 117.0) < 4
    lens = calibration.camera.distortion
    assert isinstance(lens, Brown)
    assert lens.k1 == pytest.approx(-0.25, abs=0.02)
    assert all(s > 0 for s in calibration.sigma[:8])
    with pytest.raises(BadInput, match="too few pictures"):
        calibrate_checkerboard([np.full((240, 320), 90, np.uint8)] * 4, (8, 6), 14.0)
    with pytest.raises(BadInput, match="one size"):
        calibrate_checkerboard([images[0], images[1], images[2][:100]], (8, 6), 14.0)


def test_a_missing_library_is_reported_with_its_install_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without OpenCV, the error states how to install it and names the method that does not need it."""

    def missing(_: str) -> None:
        raise ImportError("no module")

    monkeypatch.setattr(checkerboard.importlib, "import_module", missing)
    with pytest.raises(BadInput, match="OpenCV") as error:
        calibrate_checkerboard([np.zeros((20, 20), np.uint8)] * 4, (8, 6), 14.0)
    assert "pip install" in error.value.hint
    assert "star frames" in error.value.hint


@pytest.mark.parametrize("name", ["cubestar", "sunsat", "aim"])
def test_stored_cameras_are_restored(name: str, profile_of: ProfileOf) -> None:
    """A camera's record contains only plain values and restores the same camera. An incomplete record is rejected."""
    camera = profile_of(name).camera
    assert camera_from(record_of(camera)) == camera
    with pytest.raises(CorruptData, match="stored camera"):
        camera_from({"columns": 3})
    record = as_record({"a": np.array([1.0, np.nan]), "b": (np.float64(2), camera), "image": np.zeros((300, 300))})
    assert record["a"] == [1.0, None]
    assert record["b"][1]["columns"] == camera.columns
    assert record["image"] == {"shape": [300, 300]}


@pytest.mark.parametrize(
    "pairs",
    [[[5, 5, 5, 5]] * 10, [[5, 5, 90, 90]] * 10, [[1e300, 5, -1e300, k] for k in range(10)], [[np.nan, 1, 2, 3]] * 10],
)
def test_dots_that_do_not_determine_a_tilt_are_rejected(pairs: list[list[float]], profile_of: ProfileOf) -> None:
    """Coinciding dots, dots that never move, positions outside any detector, and NaN are rejected instead of giving a
    tilt with σ 0.
    """
    rows = np.array(pairs, float)
    with pytest.raises(BadInput):
        detector_tilt(rows[:, :2], rows[:, 2:], profile_of("cubestar").camera, 35.0)


@pytest.mark.parametrize("dots", [[[5, 5]] * 10, [[1e308 * (-1) ** k, 1e300 * k] for k in range(10)]])
def test_a_dot_that_does_not_determine_a_centre_is_rejected(dots: list[list[float]]) -> None:
    """A constant position and positions outside any detector are rejected."""
    with pytest.raises(BadInput):
        optical_centre(np.array(dots, float))


@pytest.mark.parametrize(
    "sigma",
    [[-1, -2, -1, -1, 5], [1, 1, 1, 1, 1], [0, 0, 0, 0, 0], [3, 1, np.nan, 1, 3], [1e300, 1, 0.5, 1, 1e300]],
)
def test_invalid_star_widths_are_rejected(sigma: list[float]) -> None:
    """Negative, equal, zero, extreme or missing widths, and equal focus settings, are rejected."""
    with pytest.raises(BadInput):
        best_focus(np.arange(5.0), np.array(sigma, float))
    with pytest.raises(BadInput, match="different settings"):
        best_focus(np.ones(4), np.array([1.0, 2.0, 3.0, 4.0]))

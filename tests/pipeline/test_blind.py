"""Patterns of four stars, and the solution of images with an unknown field of view."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.domain.rotation import rotation_angle_rad
from gss.pipeline.identify.blind import BlindResult, identify_blind
from gss.pipeline.identify.faint import Spots
from gss.pipeline.identify.patterns import PatternLevel, build_level, codes_of, radii_rad
from gss.pipeline.identify.verify import SkyCatalogue

TABLE = propagate(load_stars(), 2025.0)
SKY = SkyCatalogue(TABLE.hip, TABLE.icrs, TABLE.v_mag)
SHAPE = (1024, 768)


@functools.lru_cache(maxsize=32)
def level(radius_rad: float) -> PatternLevel:
    """Return the cached patterns of one radius."""
    return build_level(SKY, radius_rad)


def view(
    fov_deg: float,
    stars: int,
    false_count: int,
    rng: np.random.Generator,
    k1: float = 0.0,
    aspect: float = 1.0,
    offset: tuple[float, float] = (0.0, 0.0),
) -> tuple[Array, Array, Array, Array]:
    """Return pixels, magnitudes, Hipparcos numbers (−1 for false stars) and attitude of the brightest stars in a random
    field. ``offset`` is the displacement of the axis from the middle, in widths of the image.
    """
    attitude = Rotation.random(rng=rng).as_matrix()
    focal = SHAPE[0] / 2 / np.tan(np.radians(fov_deg) / 2)
    v = SKY.icrs @ attitude.T
    in_front = v[:, 2] > 0.2
    xy = v[:, :2] / np.where(in_front, v[:, 2], 1)[:, None]
    xy = xy * (1 + k1 * (xy**2).sum(1, keepdims=True)) * [focal, focal * aspect]
    xy += [(SHAPE[0] - 1) / 2 + offset[0] * SHAPE[0], (SHAPE[1] - 1) / 2 + offset[1] * SHAPE[0]]
    visible = np.flatnonzero(in_front & (xy > 0).all(1) & (xy < [SHAPE[0] - 1, SHAPE[1] - 1]).all(1))[:stars]
    pixels = np.concatenate(
        [xy[visible] + rng.normal(0, 0.2, (len(visible), 2)), rng.uniform(0, SHAPE, (false_count, 2))]
    )
    mag = np.concatenate(
        [
            SKY.v_mag[visible] + rng.normal(0, 0.2, len(visible)),
            rng.uniform(SKY.v_mag[visible].min(), SKY.v_mag[visible].max(), false_count),
        ]
    )
    order = np.argsort(mag)
    return pixels[order], mag[order], np.concatenate([SKY.hip[visible], np.full(false_count, -1)])[order], attitude


def solve(pixels: Array, mag: Array, low_deg: float, high_deg: float) -> BlindResult:
    """Identify the spots with a field of view between ``low_deg`` and ``high_deg``."""
    spots = Spots(pixels, np.full(len(pixels), 0.2), mag, 1.0)
    return identify_blind(spots, SHAPE, (np.radians(low_deg), np.radians(high_deg)), SKY, level)


def test_codes_do_not_depend_on_position_roll_scale_or_order() -> None:
    """The code of a small pattern does not change if the pattern is rotated, moved, slightly scaled or reordered. It
    changes if the pattern is mirrored.
    """
    rng = np.random.default_rng(1)
    flat = rng.uniform(-0.01, 0.01, (50, 4, 2))
    unit = np.concatenate([flat, np.ones((50, 4, 1))], axis=2)
    ids = np.arange(200, dtype=np.int32).reshape(50, 4)
    first, order, size = codes_of(unit / np.linalg.norm(unit, axis=2, keepdims=True), ids)
    rotated = np.concatenate([1.5 * flat, np.ones((50, 4, 1))], axis=2) @ Rotation.random(rng=rng).as_matrix().T
    rotated /= np.linalg.norm(rotated, axis=2, keepdims=True)
    shuffle = rng.permutation(4)
    second, second_order, second_size = codes_of(rotated[:, shuffle], ids[:, shuffle])
    assert np.allclose(first, second, atol=1e-3)
    assert (order == second_order).mean() > 0.95
    assert np.allclose(second_size / size, 1.5, rtol=1e-3)
    mirrored = unit * [-1, 1, 1]
    third, _, _ = codes_of(mirrored / np.linalg.norm(mirrored, axis=2, keepdims=True), ids)
    assert np.median(np.abs(third - first).max(axis=1)) > 0.1


def test_pattern_radii_are_shared_between_requests() -> None:
    """Requests with overlapping fields of view use the same radii, so that a caller can cache the patterns."""
    assert set(radii_rad(0.1, 0.12)) <= set(radii_rad(0.05, 0.5))


@pytest.mark.parametrize("fov_deg", [6.0, 8.5, 12.0, 18.0, 27.0, 40.0, 55.0])
def test_a_field_of_view_known_to_five_per_cent_is_solved(fov_deg: float) -> None:
    """Random fields from 6° to 55° with false stars among the brightest are solved, and no identification is wrong."""
    rng = np.random.default_rng(int(10 * fov_deg))
    solved = 0
    for k in range(6):
        pixels, mag, hip, attitude = view(fov_deg, 25, 3, rng)
        solution = solve(pixels, mag, fov_deg * (0.93 + 0.01 * k), fov_deg * (1.02 + 0.01 * k)).solved
        if solution is None:
            continue
        solved += 1
        assert (hip[solution.rows] == SKY.hip[solution.stars]).all()
        assert abs(np.degrees(solution.fit.camera.fov_rad[0]) / fov_deg - 1) < 2e-3
        assert rotation_angle_rad(solution.fit.cam_from_icrs, attitude) < 5 * solution.fit.camera.pixel_rad
    assert solved >= 5


@pytest.mark.parametrize("fov_deg", [7.0, 11.0, 30.0, 50.0])
def test_a_field_of_view_between_4_and_60_degrees_is_solved(fov_deg: float) -> None:
    """Fields are solved if only a range of 4° to 60° is known, and no identification is wrong."""
    rng = np.random.default_rng(int(fov_deg))
    solved = 0
    for _ in range(4):
        pixels, mag, hip, _ = view(fov_deg, 25, 2, rng)
        solution = solve(pixels, mag, 4, 60).solved
        if solution is not None:
            solved += 1
            assert (hip[solution.rows] == SKY.hip[solution.stars]).all()
            assert abs(np.degrees(solution.fit.camera.fov_rad[0]) / fov_deg - 1) < 2e-3
    assert solved >= 3


def test_distortion_is_recovered() -> None:
    """A barrel distortion of two per cent at the corners is recovered within a tenth of its size and with its sign."""
    rng = np.random.default_rng(3)
    pixels, mag, _, _ = view(20.0, 40, 0, rng, k1=-0.4)
    solution = solve(pixels, mag, 19, 21).solved
    assert solution is not None
    lens = solution.fit.camera.distortion
    assert isinstance(lens, Brown)
    assert abs(lens.k1 + 0.4) < 0.04
    assert solution.fit.rms_px < 0.3


def test_mirrored_fields_have_no_solution() -> None:
    """A field that is solved has no solution if it is mirrored left to right, and a reason is given."""
    rng = np.random.default_rng(4)
    for fov_deg in (9.0, 25.0):
        pixels, mag, _, _ = view(fov_deg, 25, 0, rng)
        assert solve(pixels, mag, fov_deg * 0.95, fov_deg * 1.05).solved is not None
        pixels[:, 0] = SHAPE[0] - 1 - pixels[:, 0]
        result = solve(pixels, mag, fov_deg * 0.95, fov_deg * 1.05)
        assert result.solved is None
        assert result.reason


def test_random_dots_have_no_solution() -> None:
    """Random dots have no solution, and a reason is given."""
    rng = np.random.default_rng(5)
    for n in (0, 3, 40):
        pixels = rng.uniform(0, SHAPE, (n, 2))
        result = solve(pixels, np.linspace(1, 6, n), 4, 60)
        assert result.solved is None
        assert result.reason


def test_fitted_camera_projects_stars_onto_their_pixels() -> None:
    """The fitted camera projects the matched stars onto their measured pixels."""
    rng = np.random.default_rng(6)
    pixels, mag, _, _ = view(11.0, 25, 0, rng)
    solution = solve(pixels, mag, 10.5, 11.5).solved
    assert solution is not None
    assert isinstance(solution.fit.camera, Camera)
    projected = solution.fit.camera.project(SKY.icrs[solution.stars] @ solution.fit.cam_from_icrs.T)
    assert np.sqrt(((projected - pixels[solution.rows]) ** 2).mean()) < 0.3


@pytest.mark.parametrize(
    ("fov_deg", "aspect", "offset", "low_deg", "high_deg"),
    [
        (12.0, 1.3, (0.0, 0.0), 11.5, 12.6),
        (25.0, 1 / 1.3, (0.0, 0.0), 24.0, 26.0),
        (45.0, 1.07, (0.0, 0.0), 43.0, 47.0),
        (45.0, 1.0, (0.2, 0.15), 43.0, 47.0),
        (12.0, 1.0, (0.25, 0.0), 11.5, 12.6),
        (25.0, 1.2, (0.05, 0.0), 4.0, 60.0),
        (45.0, 1.0, (0.25, 0.0), 4.0, 60.0),
    ],
)
def test_rectangular_pixels_and_displaced_axes_are_solved(
    fov_deg: float, aspect: float, offset: tuple[float, float], low_deg: float, high_deg: float
) -> None:
    """Cameras with pixels up to 1.3 times as high as wide, or with an axis up to a quarter of the width from the
    middle, are solved. Every identification is correct, and the fitted camera projects the whole field within a pixel
    of the true camera.
    """
    rng = np.random.default_rng(5)
    solved = 0
    for _ in range(2):
        pixels, mag, hip, attitude = view(fov_deg, 40, 2, rng, aspect=aspect, offset=offset)
        solution = solve(pixels, mag, low_deg, high_deg).solved
        if solution is None:
            continue
        solved += 1
        camera = solution.fit.camera
        assert (hip[solution.rows] == SKY.hip[solution.stars]).all()
        assert abs(camera.focal_row_px / camera.focal_col_px / aspect - 1) < 2e-3
        focal = SHAPE[0] / 2 / np.tan(np.radians(fov_deg) / 2)
        grid_px = np.stack(np.meshgrid(np.linspace(100, 900, 5), np.linspace(100, 660, 4)), -1).reshape(-1, 2)
        middle = np.array([(SHAPE[0] - 1) / 2 + offset[0] * SHAPE[0], (SHAPE[1] - 1) / 2 + offset[1] * SHAPE[0]])
        sky = np.concatenate([(grid_px - middle) / [focal, focal * aspect], np.ones((20, 1))], axis=1) @ attitude
        assert np.abs(camera.project(sky @ solution.fit.cam_from_icrs.T) - grid_px).max() < 1.0
    assert solved >= 1

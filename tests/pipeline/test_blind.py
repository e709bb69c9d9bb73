"""Patterns of four stars, and images with an unknown field of view."""

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
    return build_level(SKY, radius_rad)


def view(
    fov_deg: float,
    stars: int,
    false: int,
    rng: np.random.Generator,
    k1: float = 0.0,
    aspect: float = 1.0,
    off: tuple[float, float] = (0.0, 0.0),
) -> tuple[Array, Array, Array, Array]:
    """Pixels, magnitudes, Hipparcos numbers (−1 false), attitude of the brightest stars in a random field; ``off``: the axis
    from the middle, in parts of the width."""
    r = Rotation.random(rng=rng).as_matrix()
    focal = SHAPE[0] / 2 / np.tan(np.radians(fov_deg) / 2)
    v = SKY.icrs @ r.T
    ok = v[:, 2] > 0.2
    xy = v[:, :2] / np.where(ok, v[:, 2], 1)[:, None]
    xy = xy * (1 + k1 * (xy**2).sum(1, keepdims=True)) * [focal, focal * aspect]
    xy += [(SHAPE[0] - 1) / 2 + off[0] * SHAPE[0], (SHAPE[1] - 1) / 2 + off[1] * SHAPE[0]]
    on = np.flatnonzero(ok & (xy > 0).all(1) & (xy < [SHAPE[0] - 1, SHAPE[1] - 1]).all(1))[:stars]
    p = np.concatenate([xy[on] + rng.normal(0, 0.2, (len(on), 2)), rng.uniform(0, SHAPE, (false, 2))])
    mag = np.concatenate(
        [SKY.v_mag[on] + rng.normal(0, 0.2, len(on)), rng.uniform(SKY.v_mag[on].min(), SKY.v_mag[on].max(), false)]
    )
    order = np.argsort(mag)
    return p[order], mag[order], np.concatenate([SKY.hip[on], np.full(false, -1)])[order], r


def solve(pixels: Array, mag: Array, low_deg: float, high_deg: float) -> BlindResult:
    spots = Spots(pixels, np.full(len(pixels), 0.2), mag, 1.0)
    return identify_blind(spots, SHAPE, (np.radians(low_deg), np.radians(high_deg)), SKY, level)


def test_codes_do_not_depend_on_place_roll_scale_or_order() -> None:
    """A small figure keeps its code when turned, moved, scaled a little and shuffled, and loses it when mirrored."""
    rng = np.random.default_rng(1)
    flat = rng.uniform(-0.01, 0.01, (50, 4, 2))
    unit = np.concatenate([flat, np.ones((50, 4, 1))], axis=2)
    ids = np.arange(200, dtype=np.int32).reshape(50, 4)
    first, order, size = codes_of(unit / np.linalg.norm(unit, axis=2, keepdims=True), ids)
    turned = np.concatenate([1.5 * flat, np.ones((50, 4, 1))], axis=2) @ Rotation.random(rng=rng).as_matrix().T
    turned /= np.linalg.norm(turned, axis=2, keepdims=True)
    shuffle = rng.permutation(4)
    second, again, bigger = codes_of(turned[:, shuffle], ids[:, shuffle])
    assert np.allclose(first, second, atol=1e-3)
    assert (order == again).mean() > 0.95
    assert np.allclose(bigger / size, 1.5, rtol=1e-3)
    mirrored = unit * [-1, 1, 1]
    third, _, _ = codes_of(mirrored / np.linalg.norm(mirrored, axis=2, keepdims=True), ids)
    assert np.median(np.abs(third - first).max(axis=1)) > 0.1


def test_levels_of_different_requests_share_their_radii() -> None:
    """Requests for neighbouring fields ask for the same circles, so a caller's store of them is of use."""
    assert set(radii_rad(0.1, 0.12)) <= set(radii_rad(0.05, 0.5))


@pytest.mark.parametrize("fov_deg", [6.0, 8.5, 12.0, 18.0, 27.0, 40.0, 55.0])
def test_known_to_five_per_cent(fov_deg: float) -> None:
    """Random fields from 6° to 55° with false stars among the brightest are solved; no answer is wrong."""
    rng = np.random.default_rng(int(10 * fov_deg))
    solved = 0
    for k in range(6):
        pixels, mag, hip, r = view(fov_deg, 25, 3, rng)
        found = solve(pixels, mag, fov_deg * (0.93 + 0.01 * k), fov_deg * (1.02 + 0.01 * k)).solved
        if found is None:
            continue
        solved += 1
        assert (hip[found.rows] == SKY.hip[found.stars]).all()
        assert abs(np.degrees(found.fit.camera.fov_rad[0]) / fov_deg - 1) < 2e-3
        assert rotation_angle_rad(found.fit.cam_from_icrs, r) < 5 * found.fit.camera.pixel_rad
    assert solved >= 5


@pytest.mark.parametrize("fov_deg", [7.0, 11.0, 30.0, 50.0])
def test_blind(fov_deg: float) -> None:
    """The same holds if only "4° to 60°" is known."""
    rng = np.random.default_rng(int(fov_deg))
    solved = 0
    for _ in range(4):
        pixels, mag, hip, _ = view(fov_deg, 25, 2, rng)
        found = solve(pixels, mag, 4, 60).solved
        if found is not None:
            solved += 1
            assert (hip[found.rows] == SKY.hip[found.stars]).all()
            assert abs(np.degrees(found.fit.camera.fov_rad[0]) / fov_deg - 1) < 2e-3
    assert solved >= 3


def test_distortion_is_recovered() -> None:
    """A barrel of two per cent at the corners comes out with its sign and within a tenth of its size."""
    rng = np.random.default_rng(3)
    pixels, mag, _, _ = view(20.0, 40, 0, rng, k1=-0.4)
    found = solve(pixels, mag, 19, 21).solved
    assert found is not None
    lens = found.fit.camera.distortion
    assert isinstance(lens, Brown)
    assert abs(lens.k1 + 0.4) < 0.04
    assert found.fit.rms_px < 0.3


def test_mirrored_fields_have_no_solution() -> None:
    """The left-right reverse of a field that solves gives nothing."""
    rng = np.random.default_rng(4)
    for fov_deg in (9.0, 25.0):
        pixels, mag, _, _ = view(fov_deg, 25, 0, rng)
        assert solve(pixels, mag, fov_deg * 0.95, fov_deg * 1.05).solved is not None
        pixels[:, 0] = SHAPE[0] - 1 - pixels[:, 0]
        found = solve(pixels, mag, fov_deg * 0.95, fov_deg * 1.05)
        assert found.solved is None
        assert found.reason


def test_random_dots_have_no_solution() -> None:
    """Fields of dots are refused at any field of view, with a reason."""
    rng = np.random.default_rng(5)
    for n in (0, 3, 8, 12, 20, 200):
        pixels = rng.uniform(0, SHAPE, (n, 2))
        found = solve(pixels, np.linspace(1, 6, n), 4, 60)
        assert found.solved is None
        assert found.reason


def test_refined_camera_is_that_of_the_domain() -> None:
    """The fitted camera projects the matched stars onto their pixels."""
    rng = np.random.default_rng(6)
    pixels, mag, _, _ = view(11.0, 25, 0, rng)
    found = solve(pixels, mag, 10.5, 11.5).solved
    assert found is not None
    assert isinstance(found.fit.camera, Camera)
    back = found.fit.camera.project(SKY.icrs[found.stars] @ found.fit.cam_from_icrs.T)
    assert np.sqrt(((back - pixels[found.rows]) ** 2).mean()) < 0.3


@pytest.mark.parametrize(
    ("fov_deg", "aspect", "off", "low_deg", "high_deg"),
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
def test_odd_cameras(fov_deg: float, aspect: float, off: tuple[float, float], low_deg: float, high_deg: float) -> None:
    """Pixels up to 1.3 times as high as wide, and axes a quarter of the width off the middle: every name is right, and the fitted
    camera puts the whole sky within a pixel of where the true one does."""
    rng = np.random.default_rng(5)
    solved = 0
    for _ in range(2):
        pixels, mag, hip, r = view(fov_deg, 40, 2, rng, aspect=aspect, off=off)
        found = solve(pixels, mag, low_deg, high_deg).solved
        if found is None:
            continue
        solved += 1
        camera = found.fit.camera
        assert (hip[found.rows] == SKY.hip[found.stars]).all()
        assert abs(camera.focal_row_px / camera.focal_col_px / aspect - 1) < 2e-3
        focal = SHAPE[0] / 2 / np.tan(np.radians(fov_deg) / 2)
        places = np.stack(np.meshgrid(np.linspace(100, 900, 5), np.linspace(100, 660, 4)), -1).reshape(-1, 2)
        middle = np.array([(SHAPE[0] - 1) / 2 + off[0] * SHAPE[0], (SHAPE[1] - 1) / 2 + off[1] * SHAPE[0]])
        sky = np.concatenate([(places - middle) / [focal, focal * aspect], np.ones((20, 1))], axis=1) @ r
        assert np.abs(camera.project(sky @ found.fit.cam_from_icrs.T) - places).max() < 1.0
    assert solved >= 1

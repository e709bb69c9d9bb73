"""A wrong focal length is detected from the whole field, even with few matched stars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera, Pinhole
from gss.pipeline.identify import focal_census
from gss.pipeline.identify.focal_census import count_coinciding, focal_objection
from gss.pipeline.kernels import Kernels, kernels

CAMERA = Camera.from_fov(1280, 1024, np.radians(30))
RADIUS_PX = 1.0


def _field(rng: np.random.Generator, camera: Camera, stars: int = 40) -> tuple[Array, Array]:
    """Return the (n, 2) measured pixels and the (n, 3) directions of stars, for the identity attitude."""
    pixels = rng.uniform((0, 0), (camera.columns - 1, camera.rows - 1), (stars, 2))
    return pixels + 0.2 * rng.normal(size=pixels.shape), camera.unproject(pixels)


def _corner(pixels: Array, count: int) -> np.ndarray:
    """Return the rows of the ``count`` stars nearest to a corner."""
    return np.argsort(np.linalg.norm(pixels - [1200, 100], axis=1))[:count]


@pytest.mark.parametrize("scale", [0.99, 0.995, 1.005, 1.0075, 1.01])
@pytest.mark.parametrize("seed", range(5))
def test_a_wrong_focal_length_is_reported(scale: float, seed: int) -> None:
    """Four correctly matched stars in a corner, forty stars in the field and ten false stars give an objection that
    states the true focal length.
    """
    rng = np.random.default_rng(seed)
    pixels, stars = _field(rng, CAMERA.with_focal_scaled(scale))
    pixels = np.vstack([pixels, rng.uniform((0, 0), (1279, 1023), (10, 2))])
    matched = _corner(pixels[:40], 4)
    objection = focal_objection(pixels, matched, stars[matched], stars, CAMERA, RADIUS_PX)
    assert "focal length" in objection
    difference_percent = float(objection.split("one of ")[1].split(" %")[0])
    assert difference_percent == pytest.approx(100 * (scale - 1), abs=0.26)


@pytest.mark.parametrize("false_count", [0, 10, 100])
def test_the_correct_focal_length_is_accepted(false_count: int) -> None:
    """With few matched stars, half of the stars missing and false stars, at most one of sixty fields is rejected."""
    rejected = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        pixels, stars = _field(rng, CAMERA)
        visible = rng.permutation(40)[:20]
        pixels = np.vstack([pixels[visible], rng.uniform((0, 0), (1279, 1023), (false_count, 2))])
        matched = _corner(pixels[:20], 4)
        rejected += focal_objection(pixels, matched, stars[visible][matched], stars, CAMERA, RADIUS_PX) != ""
    assert rejected <= 1


def test_a_cluster_with_an_uncertain_roll_reveals_a_wrong_focal_length() -> None:
    """Six stars within 40 px leave the roll uncertain by many pixels at the edge of the field. The other stars still
    reveal the wrong focal length.
    """
    rng = np.random.default_rng(3)
    camera = CAMERA.with_focal_scaled(0.99)
    pixels, stars = _field(rng, camera)
    cluster = np.array([1200.0, 500.0]) + rng.uniform(-20, 20, (6, 2))
    pixels, stars = np.vstack([pixels, cluster]), np.vstack([stars, camera.unproject(cluster)])
    pixels[40:] += 0.2 * rng.normal(size=(6, 2))
    matched = np.arange(40, 46)
    assert "focal length" in focal_objection(pixels, matched, stars[matched], stars, CAMERA, RADIUS_PX)


def test_a_small_error_of_calibration_does_not_reject_a_solution() -> None:
    """A focal length wrong by 0.2 % is accepted, because it moves the boresight by at most two pixels."""
    rng = np.random.default_rng(4)
    pixels, stars = _field(rng, CAMERA.with_focal_scaled(1.002))
    matched = _corner(pixels, 5)
    assert focal_objection(pixels, matched, stars[matched], stars, CAMERA, RADIUS_PX) == ""


def test_frames_without_unmatched_stars_are_accepted() -> None:
    """If all centroids are matched, there is no evidence against the focal length."""
    pixels, stars = _field(np.random.default_rng(5), CAMERA, 4)
    assert focal_objection(pixels, np.arange(4), stars, stars, CAMERA, RADIUS_PX) == ""


@pytest.mark.parametrize("fast", [False, True])
@pytest.mark.parametrize("lens", [Pinhole(), Brown(k1=-0.32, k2=0.12, p1=0.004, p2=-0.006)])
def test_matches_within_the_radius_are_counted(fast: bool, lens: Pinhole | Brown) -> None:
    """Of forty matches, those displaced by less than the radius are counted, whatever their order."""
    rng = np.random.default_rng(3)
    camera = replace(CAMERA, distortion=lens)
    pixels, stars = _field(rng, camera)
    rows = rng.permutation(40)
    attitude = np.eye(3)
    predicted = camera.project(stars[rows] @ attitude.T)
    angle = rng.uniform(0, 2 * np.pi, 40)
    off_px = np.linspace(0.11, 2.5, 40)
    pixels[rows] = predicted + off_px[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for radius_px in (0.05, 1.0, 1.7, 3.0):
        count = count_coinciding(pixels, rows, stars, rows, attitude, camera, radius_px, fast)
        assert count == np.count_nonzero(off_px <= radius_px)


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch) -> list[tuple[list[list[int]], list[list[int]]]]:
    """Counts of the numpy and of the compiled loops for every call of ``count_matches``."""
    compiled = kernels(True).lists.count_matches
    calls: list[tuple[list[list[int]], list[list[int]]]] = []

    def both(*arguments: object) -> np.ndarray:
        with_numpy = focal_census._count_matches(*arguments)
        calls.append((with_numpy.tolist(), compiled(*arguments).tolist()))
        return with_numpy

    loops = replace(kernels(True).lists, count_matches=both)
    monkeypatch.setattr(focal_census, "kernels", lambda _fast: Kernels(lists=loops))
    return calls


@pytest.mark.parametrize("scale", [0.99, 1.0, 1.01])
@pytest.mark.parametrize("lens", [Pinhole(), Brown(k1=-0.32, k2=0.12, p1=0.004, p2=-0.006)])
def test_compiled_and_numpy_counts_are_equal(
    scale: float, lens: Pinhole | Brown, counts: list[tuple[list[list[int]], list[list[int]]]]
) -> None:
    """For every focal length that the census tries, both loops count the same matches and the same stars in view."""
    camera = replace(CAMERA, distortion=lens)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        pixels, stars = _field(rng, camera.with_focal_scaled(scale))
        pixels = np.vstack([pixels, rng.uniform((0, 0), (1279, 1023), (10, 2))])
        matched = _corner(pixels[:40], 2 + seed % 4)
        focal_objection(pixels, matched, stars[matched], stars, camera, RADIUS_PX)
    assert len(counts) >= 8
    assert [numpy_count for numpy_count, _ in counts] == [compiled_count for _, compiled_count in counts]


@pytest.mark.parametrize("in_corner", [2, 4])
def test_centroids_without_a_direction_are_not_counted(
    in_corner: int, counts: list[tuple[list[list[int]], list[list[int]]]]
) -> None:
    """At short focal lengths, this lens model gives no direction for some or all of the four identified centroids. They are
    not counted, in both loops."""
    camera = replace(CAMERA, distortion=Brown(k1=-1.25))
    rng = np.random.default_rng(1)
    pixels = rng.uniform((100, 100), (1180, 924), (40, 2))
    pixels[:4] = [[1200, 30], [1180, 80], [1150, 60], [1200, 120]]
    pixels[:in_corner] = [[1278 - k, k] for k in range(in_corner)]
    stars = camera.unproject(pixels)
    assert np.isfinite(stars).all()
    assert np.isnan(camera.with_focal_scaled(0.97).unproject(pixels)[:, 0]).sum() == in_corner
    pixels = np.vstack([pixels, rng.uniform((100, 100), (1180, 924), (30, 2))])
    undetected = camera.unproject(rng.uniform((100, 100), (1180, 924), (30, 2)))
    focal_objection(pixels, np.arange(4), stars[:4], np.vstack([stars[:12], undetected]), camera, RADIUS_PX)
    assert [numpy_count for numpy_count, _ in counts] == [compiled_count for _, compiled_count in counts]
    assert [len(call) for call, _ in counts] == [1, 1, 24, 24]
    assert np.max(counts[-1][0]) > 0

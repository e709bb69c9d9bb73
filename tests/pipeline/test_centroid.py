"""Centroids in windows of 5 x 5 pixels, compared with the document's test image."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.results import Centroids
from gss.pipeline.centroid import PixelNoise, brightest_first, window_centroids
from gss.pipeline.regions import find_blobs
from gss.pipeline.render import spots

NOISE = PixelNoise(dark_sigma_dn=1.5, gain_e_per_dn=5.0, floor_px=0.05)


def _centroids(image: NDArray[np.integer], threshold_dn: float = 6, black_dn: float = 0) -> Centroids:
    """Measure the centroids of all blobs above the threshold."""
    return window_centroids(image, find_blobs(image, black_dn + threshold_dn), black_dn, threshold_dn, 5, NOISE)


def _artificial_image(rng: np.random.Generator) -> tuple[NDArray[np.uint8], Array]:
    """Return the image of Erlank 2013 §4.1.6 and its true positions: eighteen stars by eq. 4.1.7 with σ = 1 on 5 x 5
    pixels, times 255, one per cell of a grid so that none touch.
    """
    cells = rng.permutation(24 * 12)[:18]
    true_px = np.column_stack([40 * (cells % 24) + 30, 40 * (cells // 24) + 20]) + rng.uniform(-8, 8, (18, 2))
    image = np.zeros((512, 1024))
    for x, y in true_px:
        col, row = np.meshgrid(np.arange(5) - 2 + round(x), np.arange(5) - 2 + round(y))
        image[row, col] = 255 * np.exp(-0.5 * ((col - x) ** 2 + (row - y) ** 2))
    return np.rint(image).astype(np.uint8), true_px


def test_the_eighteen_star_image_of_the_document() -> None:
    """All eighteen stars are found, with mean errors below the document's 0.0244 and 0.0427 px (GSS: about 0.015 px)."""
    rng = np.random.default_rng(18)
    errors = []
    for _ in range(20):
        image, true_px = _artificial_image(rng)
        centroids = _centroids(image)
        assert len(centroids) == 18
        nearest = np.argmin(np.linalg.norm(centroids.pixels[:, None] - true_px[None], axis=2), axis=1)
        assert sorted(nearest) == list(range(18))
        errors.append(np.abs(centroids.pixels - true_px[nearest]))
    mean = np.mean(errors, axis=(0, 1))
    assert mean[0] < 0.0244
    assert mean[1] < 0.0244


def test_pixels_outside_the_window_have_no_effect() -> None:
    """A tail of the same region outside the window does not change the position."""
    image = np.zeros((30, 30), np.uint8)
    image[14:17, 14:17] = 50
    image[15, 15] = 200
    without_tail = _centroids(image)
    image[15, 17:25] = 20
    with_tail = _centroids(image)
    image[15, 18:25] = 0
    assert (without_tail.col_px[0], without_tail.row_px[0]) == (15, 15)
    assert with_tail.area_px[0] == 17
    np.testing.assert_array_equal(with_tail.pixels, _centroids(image).pixels)


def test_the_black_level_is_subtracted() -> None:
    """The same star on a higher black level has the same centroid and flux."""
    image = spots(40, 40, np.array([[20.4, 18.7]]), np.array([2000.0]), 1.2)
    dark = _centroids(np.rint(image).astype(np.uint16), 10)
    raised = _centroids((np.rint(image) + 57).astype(np.uint16), 10, 57)
    np.testing.assert_array_equal(dark.pixels, raised.pixels)
    np.testing.assert_array_equal(dark.flux_dn, raised.flux_dn)


def test_a_saturated_star_has_its_centroid_in_the_middle() -> None:
    """If the brightest pixels form a plateau, the window is placed in its middle, not at its first corner two pixels
    away.
    """
    true_px = np.array([[60.3, 50.6]])
    image = np.minimum(spots(100, 120, true_px, np.array([20_000.0]), 1.4), 255).astype(np.uint8)
    assert np.count_nonzero(image == 255) > 9
    assert np.linalg.norm(_centroids(image).pixels - true_px) < 0.6


def test_sigma_agrees_with_the_error() -> None:
    """For noisy stars of all brightnesses, the rms error is between 0.5 and 1.3 times the stated ``sigma_px``."""
    rng = np.random.default_rng(5)
    for peak_e in (150.0, 400.0, 1500.0):
        true_px = np.column_stack([np.tile(np.arange(20, 1000, 20), 20), np.repeat(np.arange(20, 420, 20), 49)])
        true_px = true_px + rng.uniform(-0.5, 0.5, true_px.shape)
        light = spots(440, 1020, true_px, np.full(len(true_px), peak_e * 2 * np.pi * 1.44), 1.2)
        dn = (rng.poisson(light) + rng.normal(0, 7, light.shape)) / 5 + 10
        image = np.clip(np.rint(dn), 0, 4095).astype(np.uint16)
        centroids = _centroids(image, 13, 10)
        centroids = centroids.take(centroids.area_px >= 6)
        offset_px = centroids.pixels[:, None] - true_px[None]
        nearest = np.argmin(np.abs(offset_px).sum(axis=2), axis=1)
        error = offset_px[np.arange(len(centroids)), nearest]
        assert len(centroids) > 600
        ratio = np.sqrt(np.mean(error**2)) / np.sqrt(np.mean(centroids.sigma_px**2))
        assert 0.5 < ratio < 1.3


def test_brightest_first_is_a_stable_sort() -> None:
    """Centroids are sorted by descending flux. Centroids with equal flux keep their order."""
    centroids = Centroids.from_pixels(np.zeros((4, 2)), np.array([1.0, 5.0, 5.0, 9.0]))
    assert brightest_first(centroids).tolist() == [3, 1, 2, 0]


def test_a_dark_frame_gives_no_stars() -> None:
    """A dark frame gives an empty list of centroids."""
    assert len(_centroids(np.zeros((10, 10), np.uint8))) == 0


@pytest.mark.parametrize("shift", [(0, 3), (3, 0), (6, 9)])
def test_a_shift_of_the_frame_shifts_the_centroids(shift: tuple[int, int]) -> None:
    """A shift of the frame by whole steps of the search grid shifts every centroid by exactly the same amount."""
    image = np.rint(spots(60, 60, np.array([[20.4, 18.7], [31.2, 40.1]]), np.array([900.0, 500]), 1.2)).astype(np.uint8)
    moved = _centroids(np.roll(image, shift, axis=(0, 1)))
    np.testing.assert_allclose(moved.pixels, _centroids(image).pixels + shift[::-1], atol=1e-12)

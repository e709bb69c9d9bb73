"""5x5 centroids, with the document's own test."""

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


def _found(image: NDArray[np.integer], threshold_dn: float = 6, black_dn: float = 0) -> Centroids:
    return window_centroids(image, find_blobs(image, black_dn + threshold_dn), black_dn, threshold_dn, 5, NOISE)


def _artificial_image(rng: np.random.Generator) -> tuple[NDArray[np.uint8], Array]:
    """Erlank 2013 §4.1.6: eighteen stars, eq. 4.1.7 with σ = 1 on a 5x5 grid, times 255, one per cell so that none touch."""
    cells = rng.permutation(24 * 12)[:18]
    places = np.column_stack([40 * (cells % 24) + 30, 40 * (cells // 24) + 20]) + rng.uniform(-8, 8, (18, 2))
    image = np.zeros((512, 1024))
    for x, y in places:
        col, row = np.meshgrid(np.arange(5) - 2 + round(x), np.arange(5) - 2 + round(y))
        image[row, col] = 255 * np.exp(-0.5 * ((col - x) ** 2 + (row - y) ** 2))
    return np.rint(image).astype(np.uint8), places


def test_the_documents_eighteen_star_image() -> None:
    """All eighteen stars are found, with mean errors below the document's 0.0244 and 0.0427 px (ours: about 0.015)."""
    rng = np.random.default_rng(18)
    errors = []
    for _ in range(20):
        image, places = _artificial_image(rng)
        found = _found(image)
        assert len(found) == 18
        nearest = np.argmin(np.linalg.norm(found.pixels[:, None] - places[None], axis=2), axis=1)
        assert sorted(nearest) == list(range(18))
        errors.append(np.abs(found.pixels - places[nearest]))
    mean = np.mean(errors, axis=(0, 1))
    assert mean[0] < 0.0244
    assert mean[1] < 0.0244


def test_only_the_five_by_five_window_counts() -> None:
    """A tail of the same region outside the window moves nothing and adds no flux."""
    image = np.zeros((30, 30), np.uint8)
    image[14:17, 14:17] = 50
    image[15, 15] = 200
    bare = _found(image)
    image[15, 17:25] = 20
    tailed = _found(image)
    image[15, 18:25] = 0
    assert (bare.col_px[0], bare.row_px[0]) == (15, 15)
    assert tailed.area_px[0] == 17
    np.testing.assert_array_equal(tailed.pixels, _found(image).pixels)


def test_weights_are_counted_from_black() -> None:
    """The same star on a raised black level has the same centroid and flux."""
    image = spots(40, 40, np.array([[20.4, 18.7]]), np.array([2000.0]), 1.2)
    low = _found(np.rint(image).astype(np.uint16), 10)
    high = _found((np.rint(image) + 57).astype(np.uint16), 10, 57)
    np.testing.assert_array_equal(low.pixels, high.pixels)
    np.testing.assert_array_equal(low.flux_dn, high.flux_dn)


def test_a_saturated_star_has_its_centroid_in_the_middle() -> None:
    """With a plateau of equal brightest pixels the window sits in its middle, not at its first corner two pixels off."""
    at = np.array([[60.3, 50.6]])
    image = np.minimum(spots(100, 120, at, np.array([20_000.0]), 1.4), 255).astype(np.uint8)
    assert np.count_nonzero(image == 255) > 9
    assert np.linalg.norm(_found(image).pixels - at) < 0.6


def test_sigma_is_about_the_error() -> None:
    """Over noisy stars of all brightnesses the error is between 0.5 and 1.3 of what ``sigma_px`` says."""
    rng = np.random.default_rng(5)
    for peak_e in (150.0, 400.0, 1500.0):
        places = np.column_stack([np.tile(np.arange(20, 1000, 20), 20), np.repeat(np.arange(20, 420, 20), 49)])
        places = places + rng.uniform(-0.5, 0.5, places.shape)
        light = spots(440, 1020, places, np.full(len(places), peak_e * 2 * np.pi * 1.44), 1.2)
        dn = (rng.poisson(light) + rng.normal(0, 7, light.shape)) / 5 + 10
        image = np.clip(np.rint(dn), 0, 4095).astype(np.uint16)
        found = _found(image, 13, 10)
        found = found.take(found.area_px >= 6)
        off = found.pixels[:, None] - places[None]
        nearest = np.argmin(np.abs(off).sum(axis=2), axis=1)
        error = off[np.arange(len(found)), nearest]
        assert len(found) > 600
        ratio = np.sqrt(np.mean(error**2)) / np.sqrt(np.mean(found.sigma_px**2))
        assert 0.5 < ratio < 1.3


def test_brightest_first_keeps_the_order_of_equals() -> None:
    """Descending flux; equal stars keep their order."""
    c = Centroids.from_pixels(np.zeros((4, 2)), np.array([1.0, 5.0, 5.0, 9.0]))
    assert brightest_first(c).tolist() == [3, 1, 2, 0]


def test_no_blobs_no_stars() -> None:
    """A dark frame gives an empty list."""
    assert len(_found(np.zeros((10, 10), np.uint8))) == 0


@pytest.mark.parametrize("shift", [(0, 3), (3, 0), (6, 9)])
def test_a_shift_of_the_frame_is_a_shift_of_the_stars(shift: tuple[int, int]) -> None:
    """Moving the frame by whole steps of the search grid moves every centroid by exactly as much."""
    image = np.rint(spots(60, 60, np.array([[20.4, 18.7], [31.2, 40.1]]), np.array([900.0, 500]), 1.2)).astype(np.uint8)
    moved = _found(np.roll(image, shift, axis=(0, 1)))
    np.testing.assert_allclose(moved.pixels, _found(image).pixels + shift[::-1], atol=1e-12)

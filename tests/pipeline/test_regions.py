"""The plane search against the documents' recursion written out."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from gss.domain.errors import BadInput
from gss.pipeline.regions import SearchLimits, find_blobs, grid_median_dn, region_records, search

LIMITS = SearchLimits(min_area_px=6, max_area_px=60, max_invalid=50, max_accepted=20)


def literal_search(image: NDArray[np.uint8], threshold_dn: float) -> list[list[int]]:
    """Erlank 2013 §4.1.1–2 word for word: every third pixel, grow by recursion, set found pixels to zero."""
    pixels = image.astype(float)
    rows, columns = pixels.shape

    def grow(row: int, col: int, found: list[int]) -> None:
        found.append(row * columns + col)
        pixels[row, col] = 0
        for r, c in ((row - 1, col), (row, col - 1), (row, col + 1), (row + 1, col)):
            if 0 <= r < rows and 0 <= c < columns and pixels[r, c] > threshold_dn:
                grow(r, c, found)

    stars = []
    for row in range(0, rows, 3):
        for col in range(0, columns, 3):
            if pixels[row, col] > threshold_dn:
                found: list[int] = []
                grow(row, col, found)
                stars.append(sorted(found))
    return stars


@pytest.mark.parametrize("density", [0.02, 0.2, 0.5, 0.58, 0.7, 1.0])
@pytest.mark.parametrize("shape", [(1, 1), (2, 7), (31, 40), (30, 33), (48, 17)])
def test_blobs_are_those_of_the_recursion(density: float, shape: tuple[int, int]) -> None:
    """Same components, same pixels and same order as the literal recursion, on sparse to full random frames."""
    rng = np.random.default_rng(11)
    sys.setrecursionlimit(20_000)
    for _ in range(12):
        image = (255 * (rng.random(shape) < density)).astype(np.uint8)
        blobs = find_blobs(image, 9)
        ours = [blobs.index[a:b].tolist() for a, b in zip(blobs.start[:-1], blobs.start[1:], strict=True)]
        assert ours == literal_search(image, 9)


def _dots(*areas: int) -> NDArray[np.uint8]:
    """A frame with one bar of each area per ninth row."""
    image = np.zeros((9 * len(areas) + 9, 120), np.uint8)
    for k, area in enumerate(areas):
        image[9 * k, :area] = 100
    return image


def test_area_limits_are_inclusive_and_explained() -> None:
    """Six and sixty pixels are stars, five and sixty-one are not, and the record says why."""
    image = _dots(5, 6, 60, 61)
    found = search(image, 9, LIMITS)
    assert found.rejected == ("area 5 px < min 6", "", "", "area 61 px > max 60")
    assert found.accepted.tolist() == [1, 2]
    assert found.invalid == 1
    records = region_records(image, found, 10.0, 50)
    assert [(r.col_min, r.row_min, r.col_max, r.row_max, r.area_px) for r in records][1] == (0, 9, 5, 9, 6)
    assert records[1].sum_dn == 6 * 90
    assert records[1].peak_dn == 100


def test_search_stops_at_the_star_limit() -> None:
    """The twentieth star ends the search; what lies below is not looked at."""
    found = search(_dots(*[8] * 25), 9, LIMITS)
    assert len(found.blobs) == len(found.accepted) == 20
    assert found.stopped == "search stopped at 20 stars"


def test_exactly_the_star_limit_is_not_an_early_stop() -> None:
    """Twenty stars and nothing else is a complete search."""
    assert search(_dots(*[8] * 20), 9, LIMITS).stopped == ""


def test_search_stops_after_too_many_invalid_areas() -> None:
    """The fifty-first too large area ends the search, and a star after it is not found."""
    found = search(_dots(*[70] * 51, 8), 9, LIMITS)
    assert (found.invalid, len(found.accepted)) == (51, 0)
    assert found.stopped == "search stopped: more than 50 areas are too large"
    assert search(_dots(*[70] * 50, 8), 9, LIMITS).accepted.tolist() == [50]


def test_small_areas_are_not_invalid() -> None:
    """Hot pixels in any number do not stop the search, and only a limited number of them is recorded."""
    image = _dots(*[1] * 80, 8)
    found = search(image, 9, LIMITS)
    assert (found.invalid, found.accepted.tolist()) == (0, [80])
    assert len(region_records(image, found, 0.0, 10)) == 11


def test_region_touching_is_not_wrapped_round_the_edge() -> None:
    """The last pixel of a row and the first of the next are not neighbours."""
    image = np.zeros((6, 9), np.uint8)
    image[0, 6:] = image[1, :3] = image[3, 0] = 50
    assert find_blobs(image, 9).area_px.tolist() == [3, 1]


def test_black_frame_has_no_blobs() -> None:
    """Nothing above the threshold is an empty list."""
    found = search(np.zeros((20, 20), np.uint8), 6, LIMITS)
    assert (len(found.blobs), found.stopped, region_records(np.zeros((20, 20)), found, 0, 5)) == (0, "", ())


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float64])
def test_grid_median_is_numpys(dtype: type) -> None:
    """The black level is the lower median of the grid, whatever the pixel type."""
    image = np.random.default_rng(3).integers(0, 200, (31, 46)).astype(dtype)
    sample = np.sort(image[::3, ::3].ravel())
    assert abs(grid_median_dn(image) - np.median(sample)) <= 0.5 * (
        sample[len(sample) // 2] - sample[len(sample) // 2 - 1]
    )


@pytest.mark.parametrize("shape", [(0, 5), (4,), (2, 3, 3)])
def test_only_a_plane_is_searched(shape: tuple[int, ...]) -> None:
    """Empty frames and colour images are refused."""
    with pytest.raises(BadInput):
        find_blobs(np.zeros(shape, np.uint8), 6)

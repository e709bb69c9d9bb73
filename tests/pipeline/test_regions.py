"""The region search, compared with a literal implementation of the documents' recursion."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from gss.domain.errors import BadInput
from gss.pipeline.regions import SearchLimits, find_blobs, grid_median_dn, region_records, search

LIMITS = SearchLimits(min_area_px=6, max_area_px=60, max_invalid=50, max_accepted=20)


def literal_search(image: NDArray[np.uint8], threshold_dn: float) -> list[list[int]]:
    """Erlank 2013 §4.1.1–2 literally: check every third pixel, grow by recursion, set pixels that were found to zero."""
    pixels = image.astype(float)
    rows, columns = pixels.shape

    def grow(row: int, col: int, region: list[int]) -> None:
        region.append(row * columns + col)
        pixels[row, col] = 0
        for r, c in ((row - 1, col), (row, col - 1), (row, col + 1), (row + 1, col)):
            if 0 <= r < rows and 0 <= c < columns and pixels[r, c] > threshold_dn:
                grow(r, c, region)

    regions = []
    for row in range(0, rows, 3):
        for col in range(0, columns, 3):
            if pixels[row, col] > threshold_dn:
                region: list[int] = []
                grow(row, col, region)
                regions.append(sorted(region))
    return regions


@pytest.mark.parametrize("density", [0.02, 0.2, 0.5, 0.58, 0.7, 1.0])
@pytest.mark.parametrize("shape", [(1, 1), (2, 7), (31, 40), (30, 33), (48, 17)])
def test_blobs_agree_with_the_recursion(density: float, shape: tuple[int, int]) -> None:
    """The blobs have the same pixels and the same order as those of the literal recursion, for random frames of any
    density.
    """
    rng = np.random.default_rng(11)
    sys.setrecursionlimit(20_000)
    for _ in range(12):
        image = (255 * (rng.random(shape) < density)).astype(np.uint8)
        blobs = find_blobs(image, 9)
        components = [blobs.index[a:b].tolist() for a, b in zip(blobs.start[:-1], blobs.start[1:], strict=True)]
        assert components == literal_search(image, 9)


def _bars(*areas: int) -> NDArray[np.uint8]:
    """Return a frame with a bar of each area in every ninth row."""
    image = np.zeros((9 * len(areas) + 9, 120), np.uint8)
    for k, area in enumerate(areas):
        image[9 * k, :area] = 100
    return image


def test_area_limits_are_inclusive_and_explained() -> None:
    """Areas of six and sixty pixels are stars. Areas of five and sixty-one are not, and the record states why."""
    image = _bars(5, 6, 60, 61)
    result = search(image, 9, LIMITS)
    assert result.rejected == ("area 5 px < min 6", "", "", "area 61 px > max 60")
    assert result.accepted.tolist() == [1, 2]
    assert result.invalid == 1
    records = region_records(image, result, 10.0, 50)
    assert [(r.col_min, r.row_min, r.col_max, r.row_max, r.area_px) for r in records][1] == (0, 9, 5, 9, 6)
    assert records[1].sum_dn == 6 * 90
    assert records[1].peak_dn == 100


def test_search_stops_at_the_star_limit() -> None:
    """The search stops at the twentieth star, and regions below it are not searched."""
    result = search(_bars(*[8] * 25), 9, LIMITS)
    assert len(result.blobs) == len(result.accepted) == 20
    assert result.stopped == "search stopped at 20 stars"


def test_exactly_the_star_limit_is_not_an_early_stop() -> None:
    """With exactly twenty stars the search is complete."""
    assert search(_bars(*[8] * 20), 9, LIMITS).stopped == ""


def test_search_stops_after_too_many_invalid_areas() -> None:
    """The search stops at the fifty-first area that is too large, and a star after it is not found."""
    result = search(_bars(*[70] * 51, 8), 9, LIMITS)
    assert (result.invalid, len(result.accepted)) == (51, 0)
    assert result.stopped == "search stopped: more than 50 areas are too large"
    assert search(_bars(*[70] * 50, 8), 9, LIMITS).accepted.tolist() == [50]


def test_small_areas_do_not_stop_the_search() -> None:
    """Any number of small areas does not stop the search, and only a limited number of them is recorded."""
    image = _bars(*[1] * 80, 8)
    result = search(image, 9, LIMITS)
    assert (result.invalid, result.accepted.tolist()) == (0, [80])
    assert len(region_records(image, result, 0.0, 10)) == 11


def test_regions_do_not_continue_across_the_edge() -> None:
    """The last pixel of a row and the first pixel of the next row are not neighbours."""
    image = np.zeros((6, 9), np.uint8)
    image[0, 6:] = image[1, :3] = image[3, 0] = 50
    assert find_blobs(image, 9).area_px.tolist() == [3, 1]


def test_black_frame_has_no_blobs() -> None:
    """A frame without pixels above the threshold gives no blobs."""
    result = search(np.zeros((20, 20), np.uint8), 6, LIMITS)
    assert (len(result.blobs), result.stopped, region_records(np.zeros((20, 20)), result, 0, 5)) == (0, "", ())


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float64])
def test_grid_median_agrees_with_numpy(dtype: type) -> None:
    """The black level agrees with the median of the grid, for every pixel type."""
    image = np.random.default_rng(3).integers(0, 200, (31, 46)).astype(dtype)
    sample = np.sort(image[::3, ::3].ravel())
    assert abs(grid_median_dn(image) - np.median(sample)) <= 0.5 * (
        sample[len(sample) // 2] - sample[len(sample) // 2 - 1]
    )


@pytest.mark.parametrize("shape", [(0, 5), (4,), (2, 3, 3)])
def test_only_two_dimensional_frames_are_searched(shape: tuple[int, ...]) -> None:
    """Empty frames and arrays with one or three dimensions are rejected."""
    with pytest.raises(BadInput):
        find_blobs(np.zeros(shape, np.uint8), 6)

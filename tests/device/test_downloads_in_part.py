"""Downloads of regions, star windows and sections of a bank."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.onboard import HEADER_BYTES
from gss.device.protocol.windows import decode_windows
from gss.device.session_transfer import Part

if TYPE_CHECKING:
    from conftest import Bench


@pytest.mark.parametrize(
    ("col", "row", "columns", "rows"), [(0, 0, 1, 1), (100, 200, 64, 32), (1023, 511, 1, 1), (0, 0, 1024, 512)]
)
def test_a_region_is_that_part_of_the_image(bench: Bench, col: int, row: int, columns: int, rows: int) -> None:
    """A region has the pixels of that part of the image, row by row from the top, with one byte per pixel."""
    bench.do("TAKE_IMAGE")
    data = bench.download("region", 0, col_px=col, row_px=row, columns=columns, rows=rows)
    expected = bench.tracker.slots[0].pixels[row : row + rows, col : col + columns]
    assert data == expected.tobytes()


def test_pixels_of_ten_bits_have_two_bytes(make_bench: Callable[..., Bench]) -> None:
    """Pixels of ten bits are downloaded as two bytes, high byte first."""
    bench = make_bench(camera="far_mst")
    bench.until(lambda: bench.host.hello is not None)
    bench.do("TAKE_IMAGE")
    data = bench.download("region", 0, col_px=7, row_px=9, columns=30, rows=20)
    pixels = np.frombuffer(data, ">u2").reshape(20, 30)
    assert (pixels == bench.tracker.slots[0].pixels[9:29, 7:37]).all()


@pytest.mark.parametrize(
    ("kind", "part"),
    [
        ("region", Part(0, 0, 0, 0)),
        ("region", Part(1000, 0, 25, 1)),
        ("region", Part(0, 500, 1, 13)),
        ("region", Part(1024, 0, 1, 1)),
        ("star_windows", Part(columns=4)),
        ("star_windows", Part(columns=3)),
        ("star_windows", Part(columns=33)),
    ],
)
def test_a_part_outside_the_image_is_rejected(bench: Bench, kind: str, part: Part) -> None:
    """The device rejects regions outside the image and invalid window sizes as ``out_of_range``."""
    bench.do("TAKE_IMAGE")
    values = {"kind": kind, "target": 0, "chunk_bytes": 256, "held_sha256": bytes(32)} | vars(part)
    assert bench.refusal("OPEN_DOWNLOAD", values) == "out_of_range"


def test_star_windows_surround_the_centroids(bench: Bench) -> None:
    """The download has one window with the image's pixels per centroid. Detection runs first if necessary."""
    bench.do("TAKE_IMAGE", slot=1)
    pixels, windows = decode_windows(bench.download("star_windows", 1, columns=9))
    frame = bench.tracker.slots[1].pixels
    assert bench.tracker.detection is not None
    centroids = bench.tracker.detection.centroids
    assert len(windows) == len(centroids) > 5
    for window, col, row in zip(windows, centroids.col_px, centroids.row_px, strict=True):
        assert window.col_px <= round(col) < window.col_px + window.columns
        assert window.row_px <= round(row) < window.row_px + window.rows
        area = np.s_[window.row_px : window.row_px + window.rows, window.col_px : window.col_px + window.columns]
        assert (pixels[area] == frame[area]).all()
    assert pixels.shape == frame.shape


def test_star_list_and_distances_are_the_two_halves_of_a_bank(bench: Bench) -> None:
    """Header, star list and distance table together are the complete image of a bank."""
    image = bench.memory.content("golden")
    stars, pairs = bench.download("star_list", 3), bench.download("distance_table", 3)
    assert image[:HEADER_BYTES] + stars + pairs == image
    assert len(stars) == 14 * 411


@pytest.mark.parametrize("kind", ["catalogue", "star_list", "distance_table", "triplets", "calibration", "parameters"])
def test_a_missing_bank_cannot_be_downloaded(bench: Bench, kind: str) -> None:
    """A download from an empty bank and from a bank number that does not exist is rejected."""
    defaults = {"chunk_bytes": 256, "held_sha256": bytes(32), "col_px": 0, "row_px": 0, "columns": 0, "rows": 0}
    assert bench.refusal("OPEN_DOWNLOAD", {"kind": kind, "target": 1, **defaults}) == "bank_empty"
    assert bench.refusal("OPEN_DOWNLOAD", {"kind": kind, "target": 77, **defaults}) == "not_found"

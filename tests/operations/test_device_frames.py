"""Conversion of the bytes of an image transfer to pixels and back, complete and incomplete."""

from __future__ import annotations

import numpy as np
import pytest

from gss.device.session_transfer import Part
from gss.domain.errors import BadInput, CorruptData
from gss.operations.transfers.device_frames import Shape, picture_of, shape_of, wire_bytes

EIGHT, TWELVE = Shape(40, 30, 8), Shape(40, 30, 12)


def noise(bits: int) -> np.ndarray:
    drawn = np.random.default_rng(bits).integers(0, 1 << bits, (30, 40))
    return drawn.astype(np.uint8 if bits <= 8 else np.uint16)


@pytest.mark.parametrize("shape", [EIGHT, TWELVE])
def test_a_frame_is_unchanged_by_upload_and_download(shape: Shape) -> None:
    """Pixels are unchanged by upload and download. Those of more than eight bits have two bytes, high byte first."""
    image = noise(shape.bits)
    data = wire_bytes(image, shape)
    assert len(data) == image.size * (1 if shape.bits == 8 else 2)
    if shape.bits == 12:
        assert int.from_bytes(data[:2], "big") == image[0, 0]
    picture = picture_of("frame", data, shape, None, [])
    assert np.array_equal(picture.pixels, image)
    assert (picture.rows_held, picture.boxes, picture.complete) == (((0, 29),), (), True)


@pytest.mark.parametrize("shape", [Shape(40, 30, 8, 4), Shape(40, 30, 12, 4)])
def test_complete_rows_keep_their_dark_columns(shape: Shape) -> None:
    """A captured image includes its dark columns, an uploaded one has none, and both are unchanged by the download. Missing rows
    are found with the length of the complete rows."""
    captured = np.concatenate([noise(shape.bits), noise(shape.bits)[:, :4]], axis=1)
    for image in (captured, noise(shape.bits)):
        picture = picture_of("frame", wire_bytes(image, shape), shape, None, [])
        assert np.array_equal(picture.pixels, image)
    row = 44 * shape.wire.itemsize
    part = picture_of("frame", wire_bytes(captured, shape), shape, None, [(2 * row, 5 * row)])
    assert part.rows_held == ((2, 4),)


@pytest.mark.parametrize("shape", [EIGHT, TWELVE])
def test_an_incomplete_frame_lists_its_complete_rows(shape: Shape) -> None:
    """An incomplete frame lists the rows without a missing byte."""
    row = 40 * shape.wire.itemsize
    picture = picture_of(
        "frame", wire_bytes(noise(shape.bits), shape), shape, None, [(0, 2 * row + 1), (5 * row - 1, 9 * row)]
    )
    assert picture.rows_held == ((0, 1), (5, 8))
    assert not picture.complete


def test_a_region_keeps_its_position_and_an_incomplete_one_lists_its_rows() -> None:
    """The pixels of a region keep their position on the detector. An incomplete region lists its rows."""
    image, part = noise(12), Part(7, 11, 20, 5)
    data = wire_bytes(image, TWELVE)
    region_bytes = image[11:16, 7:27].astype(">u2").tobytes()
    picture = picture_of("region", region_bytes, TWELVE, part, [])
    assert np.array_equal(picture.pixels[11:16, 7:27], image[11:16, 7:27])
    assert picture.pixels.sum() == image[11:16, 7:27].sum()
    assert (picture.rows_held, picture.boxes, picture.complete) == (((11, 15),), ((7, 11, 20, 5),), False)
    broken = picture_of("region", region_bytes, TWELVE, part, [(0, 90)])
    assert (broken.rows_held, broken.boxes) == (((11, 12),), ((7, 11, 20, 2),))
    with pytest.raises(CorruptData):
        picture_of("region", data, TWELVE, Part(30, 0, 20, 5), [])


def test_frames_that_do_not_fit_the_detector_are_rejected_with_a_reason() -> None:
    """Frames with a wrong size, data type or range are rejected with the reason."""
    with pytest.raises(BadInput, match="does not fit") as error:
        wire_bytes(noise(8)[:20], EIGHT)
    assert (error.value.expected, error.value.got) == ("40 x 30 px", "40 x 20 px")
    with pytest.raises(BadInput, match="brighter"):
        wire_bytes(np.full((30, 40), 256, np.uint16), EIGHT)
    with pytest.raises(BadInput, match="integers"):
        wire_bytes(np.zeros((30, 40), np.float32), EIGHT)


def test_the_image_s_own_size_overrides_the_detector_s() -> None:
    """The size in the image's metadata is used. That of the device is only used if it is missing."""
    assert shape_of({"columns": 10, "rows": 5, "bits": 12}, 40, 30, 8) == Shape(10, 5, 12)
    assert shape_of({}, 40, 30, 8) == EIGHT

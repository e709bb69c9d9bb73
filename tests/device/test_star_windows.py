"""Star windows: selection, encoding and decoding."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gss.device.protocol.windows import Window, decode_windows, encode_windows, windows_round
from gss.domain.errors import BadInput, CorruptData


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 4095)])
def test_windows_are_restored_and_other_pixels_are_zero(dtype: type, top: int) -> None:
    """Decoded pixels within windows equal the frame, and all others are 0. Windows are truncated at the edges."""
    frame = np.random.default_rng(3).integers(1, top, (60, 100)).astype(dtype)
    windows = windows_round([(50.4, 30.6), (0.0, 0.0), (99.4, 59.4)], 7, 100, 60)
    assert windows == (Window(47, 28, 7, 7), Window(0, 0, 4, 4), Window(96, 56, 4, 4))
    pixels, decoded_windows = decode_windows(encode_windows(frame, windows))
    assert decoded_windows == windows
    mask = np.zeros(frame.shape, bool)
    for w in windows:
        mask[w.row_px : w.row_px + w.rows, w.col_px : w.col_px + w.columns] = True
    assert pixels.dtype == dtype
    assert np.array_equal(pixels, np.where(mask, frame, 0))


def test_the_layout_is_that_of_the_interface_document() -> None:
    """The encoded bytes are frame size, bytes per pixel, number of windows, and the position, size and pixels of each
    window, high byte first."""
    frame = np.array([[0x0102, 0x0304], [0x0506, 0x0708]], np.uint16)
    assert encode_windows(frame, [Window(1, 0, 1, 2)]).hex() == "0002000202010001000001020304" + "0708"


@given(st.binary(max_size=200))
def test_damaged_windows_raise_corrupt_data_only(data: bytes) -> None:
    """Random bytes are decoded to windows of the same encoded length, or raise ``CorruptData``."""
    try:
        pixels, windows = decode_windows(data)
    except CorruptData:
        return
    assert len(encode_windows(pixels, windows)) == len(data)


@pytest.mark.parametrize("side", [0, 3, 6, 33])
def test_even_small_or_large_sides_are_rejected(side: int) -> None:
    """The side of a window must be odd, to have a middle pixel, and between 5 and 31 pixels."""
    with pytest.raises(BadInput, match="side"):
        windows_round([(5, 5)], side, 100, 100)

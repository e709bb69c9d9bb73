"""Star windows: squares cut from a frame around its stars, as downlinked. Used by host and device.

Layout, big-endian: u16 columns and u16 rows of the frame, u8 bytes per pixel (1 or 2), u8 number of windows; then per
window u16 col_px and u16 row_px of its first pixel, u8 columns, u8 rows, and its pixels row by row. A window that would
extend beyond the frame is clipped, so its columns and rows can be fewer than the requested side.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.errors import BadInput, CorruptData

HEAD = struct.Struct(">HHBB")
WINDOW = struct.Struct(">HHBB")
SIDE_RANGE_PX = (5, 31)
MAX_WINDOWS = 255
DTYPES: dict[int, np.dtype[Any]] = {1: np.dtype(np.uint8), 2: np.dtype(">u2")}
Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class Window:
    """A rectangle of a frame: position of its first pixel and size, in pixels."""

    col_px: int
    row_px: int
    columns: int
    rows: int


def windows_round(centres: Sequence[tuple[float, float]], side_px: int, columns: int, rows: int) -> tuple[Window, ...]:
    """Return squares of an odd side around (col, row) centres, clipped to a frame of that size, in the order of the
    centres.

    Raises BadInput if the side is even or out of range. Squares that lie entirely outside the frame are omitted.
    """
    low, high = SIDE_RANGE_PX
    if side_px % 2 == 0 or not low <= side_px <= high:
        raise BadInput("the side of star windows is out of range", expected=f"odd, {low} – {high}", got=str(side_px))
    half = side_px // 2
    windows: list[Window] = []
    for col, row in centres[:MAX_WINDOWS]:
        first_col, first_row = max(0, round(col) - half), max(0, round(row) - half)
        past_col, past_row = min(columns, round(col) + half + 1), min(rows, round(row) + half + 1)
        if first_col < past_col and first_row < past_row:
            windows.append(Window(first_col, first_row, past_col - first_col, past_row - first_row))
    return tuple(windows)


def encode_windows(pixels: Pixels, windows: Sequence[Window]) -> bytes:
    """Return the encoded windows of a (rows, columns) frame."""
    pixel_bytes = pixels.dtype.itemsize
    parts = [HEAD.pack(pixels.shape[1], pixels.shape[0], pixel_bytes, len(windows))]
    for window in windows:
        parts.append(WINDOW.pack(window.col_px, window.row_px, window.columns, window.rows))
        cut = pixels[window.row_px : window.row_px + window.rows, window.col_px : window.col_px + window.columns]
        parts.append(np.ascontiguousarray(cut, DTYPES[pixel_bytes]).tobytes())
    return b"".join(parts)


def decode_windows(data: bytes) -> tuple[Pixels, tuple[Window, ...]]:
    """Return a (rows, columns) frame with zeros outside the windows, and the windows.

    Raises CorruptData if the bytes are invalid.
    """
    if len(data) < HEAD.size:
        raise CorruptData("star windows are too short", expected=f"{HEAD.size} B", got=f"{len(data)} B")
    columns, rows, pixel_bytes, count = HEAD.unpack_from(data)
    if pixel_bytes not in DTYPES:
        raise CorruptData(
            "the pixels of star windows have an unsupported size", expected="1 or 2 bytes each", got=str(pixel_bytes)
        )
    pixels = np.zeros((rows, columns), np.uint8 if pixel_bytes == 1 else np.uint16)
    at = HEAD.size
    windows: list[Window] = []
    for _ in range(count):
        if at + WINDOW.size > len(data):
            raise CorruptData("star windows end too early", expected=f"{count} windows", got=f"{len(windows)}")
        window = Window(*WINDOW.unpack_from(data, at))
        at += WINDOW.size
        size = window.columns * window.rows * pixel_bytes
        if at + size > len(data) or window.col_px + window.columns > columns or window.row_px + window.rows > rows:
            raise CorruptData("a star window does not fit", expected=f"inside {columns} x {rows} px", got=str(window))
        cut = np.frombuffer(data, DTYPES[pixel_bytes], window.columns * window.rows, at).reshape(
            window.rows, window.columns
        )
        pixels[window.row_px : window.row_px + window.rows, window.col_px : window.col_px + window.columns] = cut
        windows.append(window)
        at += size
    if at != len(data):
        raise CorruptData("star windows are too long", expected=f"{at} B", got=f"{len(data)} B")
    return pixels, tuple(windows)

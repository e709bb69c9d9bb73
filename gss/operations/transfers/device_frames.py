"""Pure functions that convert the bytes of a complete or partial image transfer to pixels, and mark the received
pixels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.device.protocol.windows import decode_windows
from gss.device.session_transfer import Part
from gss.domain.errors import BadInput, CorruptData

THUMBNAIL_FACTOR = 4
Pixels = NDArray[np.uint8] | NDArray[np.uint16]
Box = tuple[int, int, int, int]
"""(first column, first row, columns, rows) in pixels."""


@dataclass(frozen=True)
class Shape:
    """Format of an image on board: columns, rows, bits per pixel. Pixels with more than eight bits are sent as two
    bytes, high byte first. ``dark_columns``: number of dark columns that each row of a captured image has in addition."""

    columns: int
    rows: int
    bits: int
    dark_columns: int = 0

    @property
    def wire(self) -> np.dtype[Any]:
        """Data type of a pixel on the link."""
        return np.dtype(np.uint8) if self.bits <= 8 else np.dtype(">u2")


@dataclass(frozen=True)
class DeviceImage:
    """Image with its received parts. ``pixels``: (rows, columns), 0 for missing pixels; ``rows_held``: inclusive ranges
    of received rows; ``boxes``: received rectangles if only a part of the image was requested; ``complete``: True for a
    full image without gaps."""

    pixels: Pixels
    rows_held: tuple[tuple[int, int], ...]
    boxes: tuple[Box, ...]
    complete: bool


def shape_of(info: Mapping[str, Any], columns: int, rows: int, bits: int, dark_columns: int = 0) -> Shape:
    """Return the format from the report of the image. For values that the report does not contain, use the values of
    the detector."""
    size = int(info.get("columns") or columns), int(info.get("rows") or rows)
    return Shape(*size, int(info.get("bits") or bits or 8), dark_columns)


def picture_of(
    kind: str, data: bytes, shape: Shape, part: Part | None, held_bytes: Sequence[tuple[int, int]]
) -> DeviceImage:
    """Return the pixels of a transfer. The rows of a captured image include the dark columns. ``held_bytes``: half-open
    ranges of received bytes, empty if all bytes were received. Raises CorruptData."""
    if kind == "star_windows":
        return _windows(data)
    if kind == "region" and part is not None:
        return _region(data, shape, part, held_bytes)
    factor = THUMBNAIL_FACTOR if kind == "thumbnail" else 1
    columns = shape.columns // factor
    if kind == "frame" and len(data) == (columns + shape.dark_columns) * shape.rows * shape.wire.itemsize:
        columns += shape.dark_columns  # an uploaded image has no dark columns
    pixels = _grid(data, columns, shape.wire)
    rows = _complete_rows(held_bytes, columns * shape.wire.itemsize, len(pixels))
    return DeviceImage(pixels, rows, (), not held_bytes)


def _grid(data: bytes, columns: int, wire: np.dtype[Any]) -> Pixels:
    if columns <= 0:
        raise CorruptData("the size of the image is not known", hint="send LIST_FRAMES, which reports it")
    rows = len(data) // (columns * wire.itemsize)
    flat = np.frombuffer(data, wire, rows * columns)
    pixels: Pixels = flat.astype(np.uint8) if wire.itemsize == 1 else flat.astype(np.uint16)
    return pixels.reshape(rows, columns)


def _complete_rows(held_bytes: Sequence[tuple[int, int]], row_bytes: int, rows: int) -> tuple[tuple[int, int], ...]:
    """Return inclusive ranges of completely received rows. An empty ``held_bytes`` means that all rows were
    received."""
    if not held_bytes:
        return ((0, rows - 1),)
    row_ranges = ((math.ceil(a / row_bytes), min(b // row_bytes, rows) - 1) for a, b in held_bytes)
    return tuple((first, last) for first, last in row_ranges if first <= last)


def _region(data: bytes, shape: Shape, part: Part, held_bytes: Sequence[tuple[int, int]]) -> DeviceImage:
    """Return a full-size image that contains a rectangle, so that pixel coordinates refer to the detector."""
    columns_fit = part.columns > 0 and part.col_px + part.columns <= shape.columns
    if not columns_fit or part.row_px + part.rows > shape.rows:
        raise CorruptData(
            "the region extends beyond the image", expected=f"{shape.columns} x {shape.rows} px", got=str(part)
        )
    region_pixels = _grid(data, part.columns, shape.wire)[: part.rows]
    pixels = np.zeros((shape.rows, shape.columns), region_pixels.dtype)
    pixels[part.row_px : part.row_px + len(region_pixels), part.col_px : part.col_px + part.columns] = region_pixels
    rows = _complete_rows(held_bytes, part.columns * shape.wire.itemsize, len(region_pixels))
    boxes = tuple((part.col_px, part.row_px + a, part.columns, b - a + 1) for a, b in rows)
    return DeviceImage(pixels, tuple((part.row_px + a, part.row_px + b) for a, b in rows), boxes, False)


def _windows(data: bytes) -> DeviceImage:
    """Return a full-size image that contains square star windows."""
    pixels, windows = decode_windows(data)
    boxes = tuple((w.col_px, w.row_px, w.columns, w.rows) for w in windows)
    has_pixels = np.zeros(len(pixels) + 2, bool)
    for w in windows:
        has_pixels[w.row_px + 1 : w.row_px + 1 + w.rows] = True
    edges = np.flatnonzero(has_pixels[1:] != has_pixels[:-1])
    rows = tuple((int(a), int(b) - 1) for a, b in edges.reshape(-1, 2))
    return DeviceImage(pixels, rows, boxes, False)


def wire_bytes(pixels: NDArray[np.generic], shape: Shape) -> bytes:
    """Convert a stored frame to the format of the image memory. Raises BadInput if the frame does not fit the
    detector."""
    if pixels.shape not in ((shape.rows, shape.columns), (shape.rows, shape.columns + shape.dark_columns)):
        got = f"{pixels.shape[1]} x {pixels.shape[0]} px"
        raise BadInput("the frame does not fit the detector", expected=f"{shape.columns} x {shape.rows} px", got=got)
    if pixels.dtype.kind != "u":
        raise BadInput("the frame does not contain integers", expected=f"{shape.bits} bits", got=str(pixels.dtype))
    brightest = int(pixels.max(initial=0))
    if brightest >= 1 << shape.bits:
        raise BadInput(
            "the frame has brighter pixels than the detector",
            expected=f"at most {(1 << shape.bits) - 1}",
            got=str(brightest),
        )
    return pixels.astype(shape.wire).tobytes()

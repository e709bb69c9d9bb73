"""Bytes of an image transfer to pixels, and which of them are real. Pure: the same for what is whole and what broke off."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.device.protocol.windows import decode_windows
from gss.device.session import Part
from gss.domain.errors import BadInput, CorruptData

THUMBNAIL_FACTOR = 4
Pixels = NDArray[np.uint8] | NDArray[np.uint16]
Box = tuple[int, int, int, int]
"""First column, first row, columns, rows."""


@dataclass(frozen=True)
class Shape:
    """An image on board: columns, rows, bits of a pixel. More than eight bits travel as two bytes, high byte first."""

    columns: int
    rows: int
    bits: int

    @property
    def wire(self) -> np.dtype[Any]:
        """A pixel on the link."""
        return np.dtype(np.uint8) if self.bits <= 8 else np.dtype(">u2")


@dataclass(frozen=True)
class Picture:
    """(rows, columns) pixels with 0 where nothing came. ``boxes``: the rectangles that are real, where only a part was asked
    for; ``rows_held``: row ranges, inclusive, with real pixels; ``complete``: the whole image and all of it."""

    pixels: Pixels
    rows_held: tuple[tuple[int, int], ...]
    boxes: tuple[Box, ...]
    complete: bool


def shape_of(info: Mapping[str, Any], columns: int, rows: int, bits: int) -> Shape:
    """The image's own word where there is one, else the detector's."""
    return Shape(int(info.get("columns") or columns), int(info.get("rows") or rows), int(info.get("bits") or bits or 8))


def picture_of(
    kind: str, data: bytes, shape: Shape, part: Part | None, held_bytes: Sequence[tuple[int, int]]
) -> Picture:
    """Pixels of a transfer. ``held_bytes``: half-open byte ranges that came, empty where all did."""
    if kind == "star_windows":
        return _windows(data)
    if kind == "region" and part is not None:
        return _region(data, shape, part, held_bytes)
    factor = THUMBNAIL_FACTOR if kind == "thumbnail" else 1
    columns = shape.columns // factor
    pixels = _grid(data, columns, shape.wire)
    rows = _whole_rows(held_bytes, columns * shape.wire.itemsize, len(pixels))
    return Picture(pixels, rows, (), not held_bytes)


def _grid(data: bytes, columns: int, wire: np.dtype[Any]) -> Pixels:
    if columns <= 0:
        raise CorruptData("the size of the image is not known", hint="LIST_FRAMES tells it")
    rows = len(data) // (columns * wire.itemsize)
    flat = np.frombuffer(data, wire, rows * columns)
    pixels: Pixels = flat.astype(np.uint8) if wire.itemsize == 1 else flat.astype(np.uint16)
    return pixels.reshape(rows, columns)


def _whole_rows(held_bytes: Sequence[tuple[int, int]], row_bytes: int, rows: int) -> tuple[tuple[int, int], ...]:
    """Rows that came whole; all of them where nothing is missing."""
    if not held_bytes:
        return ((0, rows - 1),)
    whole = ((math.ceil(a / row_bytes), min(b // row_bytes, rows) - 1) for a, b in held_bytes)
    return tuple((first, last) for first, last in whole if first <= last)


def _region(data: bytes, shape: Shape, part: Part, held_bytes: Sequence[tuple[int, int]]) -> Picture:
    """A rectangle at its place in an image of the full size: pixel coordinates stay those of the detector."""
    inside = part.columns > 0 and part.col_px + part.columns <= shape.columns
    if not inside or part.row_px + part.rows > shape.rows:
        raise CorruptData("a region outside the image", expected=f"{shape.columns} x {shape.rows} px", got=str(part))
    cut = _grid(data, part.columns, shape.wire)[: part.rows]
    pixels = np.zeros((shape.rows, shape.columns), cut.dtype)
    pixels[part.row_px : part.row_px + len(cut), part.col_px : part.col_px + part.columns] = cut
    rows = _whole_rows(held_bytes, part.columns * shape.wire.itemsize, len(cut))
    boxes = tuple((part.col_px, part.row_px + a, part.columns, b - a + 1) for a, b in rows)
    return Picture(pixels, tuple((part.row_px + a, part.row_px + b) for a, b in rows), boxes, False)


def _windows(data: bytes) -> Picture:
    """Squares at their places in an image of the full size."""
    pixels, windows = decode_windows(data)
    boxes = tuple((w.col_px, w.row_px, w.columns, w.rows) for w in windows)
    real = np.zeros(len(pixels) + 2, bool)
    for w in windows:
        real[w.row_px + 1 : w.row_px + 1 + w.rows] = True
    edges = np.flatnonzero(real[1:] != real[:-1])
    rows = tuple((int(a), int(b) - 1) for a, b in edges.reshape(-1, 2))
    return Picture(pixels, rows, boxes, False)


def wire_bytes(pixels: NDArray[np.generic], shape: Shape) -> bytes:
    """A stored frame as image memory takes it; BadInput where it does not fit the detector."""
    if pixels.shape != (shape.rows, shape.columns):
        got = f"{pixels.shape[1]} x {pixels.shape[0]} px"
        raise BadInput("the frame does not fit the detector", expected=f"{shape.columns} x {shape.rows} px", got=got)
    if pixels.dtype.kind != "u":
        raise BadInput("the frame is not of whole numbers", expected=f"{shape.bits} bits", got=str(pixels.dtype))
    brightest = int(pixels.max(initial=0))
    if brightest >= 1 << shape.bits:
        raise BadInput(
            "the frame has brighter pixels than the detector",
            expected=f"at most {(1 << shape.bits) - 1}",
            got=str(brightest),
        )
    return pixels.astype(shape.wire).tobytes()

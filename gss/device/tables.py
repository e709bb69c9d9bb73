"""Encode and decode calibration, parameter and bad-pixel tables as stored in the sensor. Used by the ground and the simulator.

A table contains one text (the distortion model of a calibration, or the chain of a parameter set) and named numbers.
A bad-pixel table contains positions instead of named numbers; its text is the replacement of the pixels. Triplet tables
have a separate format: ``gss.catalogue_tools.formats.triplet_table``. Little-endian, like bank images.

Header, offset type meaning
     0  4s   magic "GSSK" (calibration), "GSSP" (parameters) or "GSSD" (bad pixels)
     4  u8   format version, 1
     5  u8   0
     6  u16  length of the header, 64
     8  16s  name of the camera profile, UTF-8, padded with zeros
    24  16s  the text, UTF-8, padded with zeros
    40  u16  number of values or pixels, n
    42  u16  0
    44  u32  length of the body
    48  8s   0
    56  u32  CRC-32 of the body
    60  u32  CRC-32 of the 60 bytes before

Body: n times u8 length of the name, the name in ASCII, f64 value; names ascending and unique. Values are finite.
Body of a bad-pixel table: n times u16 column, u16 row; ascending by row, then by column, and unique.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gss.device.protocol.codec import text_of
from gss.domain.errors import BadInput, CorruptData

TABLE_FORMAT = 1
BAD_PIXELS = "bad_pixels"
MAGICS = {"calibration": b"GSSK", "parameters": b"GSSP", BAD_PIXELS: b"GSSD"}
WORDS = {"calibration": "distortion", "parameters": "chain"}
REPLACEMENT = "median"
"""Replacement of a bad pixel: the median of the good pixels among its eight neighbours."""
HEADER = struct.Struct("<4sBBH16s16sHHI8sI")
HEADER_BYTES = HEADER.size + 4
NUMBER = struct.Struct("<d")
MAX_NAME_LENGTH, MAX_PAIRS = 40, 200
TABLE_BYTES = 4096
"""Size of a calibration or a parameter set in flash: one sector."""
BAD_PIXEL_BYTES = 8 * TABLE_BYTES
"""Size of a bad-pixel table in flash: 8176 pixels, which is 1.5 % of the largest detector of the documents."""
NO_PIXELS: NDArray[np.intp] = np.zeros((0, 2), np.intp)
PIXEL = np.dtype([("col", "<u2"), ("row", "<u2")])

Scalar = float | int | bool | str


def encode_table(kind: str, profile_name: str, values: Mapping[str, Scalar]) -> bytes:
    """Return the bytes of a table. ``values``: contains the text with the key "distortion" or "chain".

    Raises BadInput naming the invalid value.
    """
    word_name = _word_name(kind)
    word = values.get(word_name)
    if not isinstance(word, str) or not word:
        raise BadInput(f"{kind}: {word_name} is missing", expected="a name", got=repr(word))
    numbers = {name: _number(kind, name, value) for name, value in values.items() if name != word_name}
    if len(numbers) > MAX_PAIRS:
        raise BadInput(f"{kind}: too many values", expected=f"at most {MAX_PAIRS}", got=str(len(numbers)))
    body = b"".join(
        bytes([len(name)]) + name.encode("ascii") + NUMBER.pack(number) for name, number in sorted(numbers.items())
    )
    data = _with_header(kind, profile_name, _fixed(kind, word_name, word), len(numbers), body)
    if len(data) > TABLE_BYTES:
        raise BadInput(f"{kind}: too long", expected=f"at most {TABLE_BYTES} B", got=f"{len(data)} B")
    return data


def encode_bad_pixels(profile_name: str, pixels: NDArray[np.integer]) -> bytes:
    """Return the bytes of a bad-pixel table. ``pixels``: (k, 2) column and row in any order. Raises BadInput if the
    pixels do not fit into the table."""
    rows = np.unique(np.asarray(pixels, np.int64).reshape(-1, 2)[:, ::-1], axis=0)
    most = (BAD_PIXEL_BYTES - HEADER_BYTES) // PIXEL.itemsize
    if len(rows) > most:
        raise BadInput("too many bad pixels", expected=f"at most {most}", got=str(len(rows)))
    if len(rows) and not 0 <= rows.min() <= rows.max() <= 0xFFFF:
        raise BadInput(
            "a bad pixel has an impossible position", expected="0 – 65535", got=f"{rows.min()}, {rows.max()}"
        )
    body = np.ascontiguousarray(rows[:, ::-1]).astype("<u2").tobytes()
    return _with_header(BAD_PIXELS, profile_name, _fixed(BAD_PIXELS, "text", REPLACEMENT), len(rows), body)


def _with_header(kind: str, profile_name: str, text: bytes, count: int, body: bytes) -> bytes:
    header = HEADER.pack(
        MAGICS[kind],
        TABLE_FORMAT,
        0,
        HEADER_BYTES,
        _fixed(kind, "profile", profile_name),
        text,
        count,
        0,
        len(body),
        bytes(8),
        zlib.crc32(body),
    )
    return header + zlib.crc32(header).to_bytes(4, "little") + body


def _word_name(kind: str) -> str:
    if kind not in WORDS:
        raise BadInput("unknown kind of table", expected=" | ".join(WORDS), got=kind)
    return WORDS[kind]


def _number(kind: str, name: str, value: object) -> float:
    if not name.isascii() or not name.isidentifier() or len(name) > MAX_NAME_LENGTH:
        raise BadInput(f"{kind}: not a name", expected=f"letters, digits, _, at most {MAX_NAME_LENGTH}", got=repr(name))
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise BadInput(f"{kind}: {name} is not a number", expected="a finite number", got=repr(value))
    return float(value)


def _fixed(kind: str, field: str, text: str) -> bytes:
    data = text.encode()
    if not data or len(data) > 16 or b"\0" in data:
        raise BadInput(f"{kind}: {field} does not fit", expected="1 – 16 bytes", got=repr(text))
    return data.ljust(16, b"\0")


def decode_table(kind: str, data: bytes) -> tuple[str, dict[str, Scalar]]:
    """Return the profile name and the values. Raises CorruptData if the bytes are damaged or not a table of this
    kind."""
    word_name = _word_name(kind)
    profile_name, word, count, body = _without_header(kind, data)
    values: dict[str, Scalar] = {word_name: word}
    return profile_name, values | _pairs(kind, body, count)


def decode_bad_pixels(data: bytes) -> tuple[str, NDArray[np.intp]]:
    """Return the profile name and the (k, 2) columns and rows. Raises CorruptData if the bytes are damaged or not a
    bad-pixel table."""
    profile_name, text, count, body = _without_header(BAD_PIXELS, data)
    if text != REPLACEMENT:
        raise CorruptData("unknown replacement of bad pixels", expected=REPLACEMENT, got=text)
    if len(body) != count * PIXEL.itemsize:
        raise CorruptData("the bad-pixel table has a wrong length", expected=f"{count} pixels", got=f"{len(body)} B")
    cells = np.frombuffer(body, PIXEL)
    flat = cells["row"].astype(np.int64) << 16 | cells["col"]
    if (np.diff(flat) <= 0).any():
        raise CorruptData(
            "the bad pixels are not in order", expected="ascending rows, then columns, without repetition"
        )
    return profile_name, np.column_stack([cells["col"], cells["row"]]).astype(np.intp)


def _without_header(kind: str, data: bytes) -> tuple[str, str, int, bytes]:
    """Return profile name, text, number of entries and body."""
    if len(data) < HEADER_BYTES:
        raise CorruptData(f"not a {kind} table", expected=f"at least {HEADER_BYTES} B", got=f"{len(data)} B")
    magic, version, _, size, profile, word, count, _, body_bytes, _, body_crc = HEADER.unpack_from(data)
    if magic != MAGICS[kind]:
        raise CorruptData(f"not a {kind} table", expected=MAGICS[kind].decode(), got=repr(magic))
    if zlib.crc32(data[: HEADER.size]) != int.from_bytes(data[HEADER.size : HEADER_BYTES], "little"):
        raise CorruptData(f"header of the {kind} table is damaged", expected="a matching CRC-32")
    if (version, size) != (TABLE_FORMAT, HEADER_BYTES):
        raise CorruptData(f"unknown format of the {kind} table", expected=str(TABLE_FORMAT), got=str(version))
    body = data[HEADER_BYTES:]
    if len(body) != body_bytes or zlib.crc32(body) != body_crc:
        raise CorruptData(f"body of the {kind} table is damaged", expected=f"{body_bytes} B and a matching CRC-32")
    return _text(kind, profile), _text(kind, word), count, body


def _text(kind: str, data: bytes) -> str:
    try:
        return text_of(data.rstrip(b"\0"))
    except UnicodeDecodeError:
        raise CorruptData(f"{kind} table: a name is not valid UTF-8") from None


def _pairs(kind: str, body: bytes, count: int) -> dict[str, float]:
    numbers: dict[str, float] = {}
    at, previous = 0, ""
    for _ in range(count):
        end = at + 1 + (body[at] if at < len(body) else 0)
        if at >= len(body) or end + NUMBER.size > len(body):
            raise CorruptData(f"{kind} table ends too early", expected=f"{count} values", got=str(len(numbers)))
        name = body[at + 1 : end].decode("ascii", "replace")
        (number,) = NUMBER.unpack_from(body, end)
        if not name.isidentifier() or name <= previous or not math.isfinite(number):
            raise CorruptData(f"{kind} table: a value is impossible", got=f"{name!r} = {number}")
        numbers[name], previous = number, name
        at = end + NUMBER.size
    if at != len(body):
        raise CorruptData(f"{kind} table is too long", expected=f"{at} B", got=f"{len(body)} B")
    return numbers

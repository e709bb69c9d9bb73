"""Stored form of the regions and stars of a solution: packed arrays in the JSON document, which need a tenth of the
space of plain text.

Positions are stored to 1e-5 px, magnitudes to 1e-4, fluxes, residuals and weights to seven digits. Lists without the
expected fields are stored unchanged. Rows with plain lists, which older versions wrote, are read unchanged.
"""

from __future__ import annotations

import json
import math
import zlib
from base64 import b64decode, b64encode, b85decode
from collections.abc import Callable
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gss.domain.json_object import JsonObject

POSITION_STEP_PX = 1e-5
MAGNITUDE_STEP = 1e-4
NO_MAGNITUDE = np.iinfo(np.int32).min
LARGEST, MAX_FLOAT = float(1 << 31), 3e38
PACKED = "packed64"
DECODERS: dict[str, Callable[[str], bytes]] = {PACKED: b64decode, "packed": b85decode}
"""Keys of packed lists, and the decoder of their text. Earlier rows use base 85, which Python
encodes slowly."""
Rows = list[JsonObject]
BOUNDS = ("col_min", "row_min", "col_max", "row_max", "area_px")
CENTROID_FIELDS = ("index", "col_px", "row_px", "flux_dn", "peak_dn", "area_px")
CENTROID_COLUMNS = len(CENTROID_FIELDS) - 1
"""Stored columns of four bytes per centroid; the index is not stored."""
MATCH_FIELDS = ("hip", "name", "v_mag", "dx_px", "dy_px", "dx_arcsec", "dy_arcsec", "weight")


def packed(detail: JsonObject) -> JsonObject:
    """Return the document with packed lists. Lists without the fields of regions or stars stay plain, and a packed
    document stays unchanged."""
    arrays = {}
    for name, pack in (("regions", _pack_regions), ("stars", _pack_stars)):
        if detail.get(name):
            try:
                arrays[name] = _text(pack(detail[name]))
            except (KeyError, TypeError, ValueError, OverflowError):  # other fields, or a number out of range
                continue
    if not arrays:
        return detail
    return {name: value for name, value in detail.items() if name not in arrays} | {PACKED: arrays}


def unpacked(detail: JsonObject) -> JsonObject:
    """Return the document with plain lists."""
    key = next((key for key in DECODERS if key in detail), None)
    if key is None:
        return detail
    plain = {name: value for name, value in detail.items() if name != key}
    for name, unpack in (("regions", _unpack_regions), ("stars", _unpack_stars)):
        if name in detail[key]:
            plain[name] = unpack(_DetailReader(zlib.decompress(DECODERS[key](detail[key][name]))))
    return plain


class StoredDetail(TypedDict, total=False):
    """Document as it is stored: plain stars, or the texts of packed lists in one of the two forms."""

    stars: Rows
    packed: dict[str, str]
    packed64: dict[str, str]


def residuals_px(detail: StoredDetail) -> dict[int, float | None]:
    """Return the Hipparcos number of each matched star with the distance between its measured and predicted position, None
    if it is not stored. Reads a packed document without building its rows."""
    forms = ((b64decode, detail.get("packed64", {})), (b85decode, detail.get("packed", {})))
    packed_stars = next((decode(lists["stars"]) for decode, lists in forms if "stars" in lists), None)
    if packed_stars is None:
        offsets = [
            (star["hip"], star.get("dx_px"), star.get("dy_px")) for star in detail.get("stars", []) if "hip" in star
        ]
        return {hip: None if dx is None or dy is None else math.hypot(dx, dy) for hip, dx, dy in offsets}
    reader = _DetailReader(zlib.decompress(packed_stars))
    count = reader.count()
    reader.numbers("<u4", CENTROID_COLUMNS * count)
    matches = reader.count()
    reader.numbers("<u4", matches)  # indices
    hip = reader.numbers("<i4", matches)
    reader.numbers("<i4", matches)  # magnitudes
    dx_px, dy_px = (reader.numbers("<f4", matches) for _ in range(2))
    distances = np.hypot(dx_px, dy_px).tolist()
    return {number: None if math.isnan(d) else d for number, d in zip(hip.tolist(), distances, strict=True)}


def _text(parts: list[bytes]) -> str:
    return b64encode(zlib.compress(b"".join(parts))).decode("ascii")


def _integers(rows: Rows, name: str, step: float = 1.0) -> bytes:
    """Return a column in multiples of ``step`` as the bytes of an int32 array. Raises ValueError if a number is out of
    range."""
    values = np.round(np.array([row[name] for row in rows], float) / step)
    if not (np.abs(values) < LARGEST).all():  # the comparison is also false for NaN, which represents a missing number
        raise ValueError(name)
    return values.astype("<i4").tobytes()


def _floats(rows: Rows, name: str, *, missing: bool = False) -> bytes:
    """Return a column as the bytes of a float32 array. Raises ValueError if a number is out of range, or is missing
    although ``missing`` is false."""
    values = np.array([row[name] for row in rows], float)
    allowed = np.isnan(values) if missing else np.zeros(len(values), bool)
    if not (allowed | (np.abs(values) < MAX_FLOAT)).all():
        raise ValueError(name)
    return values.astype("<f4").tobytes()


def _texts(texts: list[str]) -> bytes:
    data = json.dumps(texts, ensure_ascii=False, separators=(",", ":")).encode()
    return np.array([len(data)], "<u4").tobytes() + data


def _pack_regions(rows: Rows) -> list[bytes]:
    if any(set(row) != {*BOUNDS, "peak_dn", "rejected"} for row in rows):
        raise KeyError
    numbers = [_integers(rows, name) for name in BOUNDS]
    reasons = [str(row["rejected"]) for row in rows]
    return [_count(len(rows)), *numbers, _floats(rows, "peak_dn"), _texts(reasons)]


def _unpack_regions(reader: _DetailReader) -> Rows:
    count = reader.count()
    columns = {name: reader.numbers("<i4", count).tolist() for name in BOUNDS}
    columns["peak_dn"] = _shortest(reader.numbers("<f4", count))
    columns["rejected"] = reader.texts()
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def _pack_stars(rows: Rows) -> list[bytes]:
    matched = [row for row in rows if "hip" in row]
    if any(set(row) != ({*CENTROID_FIELDS, *MATCH_FIELDS} if "hip" in row else {*CENTROID_FIELDS}) for row in rows):
        raise KeyError
    if [row["index"] for row in rows] != list(range(len(rows))):
        raise ValueError("index")
    columns = [_integers(rows, name, POSITION_STEP_PX) for name in ("col_px", "row_px")]
    columns += [_floats(rows, name) for name in ("flux_dn", "peak_dn")]
    match_indices = np.array([row["index"] for row in matched], "<u4").tobytes()
    magnitudes = [NO_MAGNITUDE if m["v_mag"] is None else round(m["v_mag"] / MAGNITUDE_STEP) for m in matched]
    match_columns = [_integers(matched, "hip"), np.array(magnitudes, "<i4").tobytes()]
    match_columns += [_floats(matched, name, missing=True) for name in MATCH_FIELDS[3:]]
    names = _texts([str(row["name"]) for row in matched])
    return [
        _count(len(rows)),
        *columns,
        _integers(rows, "area_px"),
        _count(len(matched)),
        match_indices,
        *match_columns,
        names,
    ]


def _unpack_stars(reader: _DetailReader) -> Rows:
    count = reader.count()
    columns: dict[str, list[Any]] = {"index": list(range(count))}
    columns |= {name: _decimal(reader.numbers("<i4", count), 5) for name in ("col_px", "row_px")}
    columns |= {name: _shortest(reader.numbers("<f4", count)) for name in ("flux_dn", "peak_dn")}
    columns["area_px"] = reader.numbers("<i4", count).tolist()
    rows = [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
    matches = reader.count()
    match_indices = reader.numbers("<u4", matches)
    hip, v_mag = reader.numbers("<i4", matches).tolist(), reader.numbers("<i4", matches)
    match_columns: dict[str, list[Any]] = {"hip": hip, "name": []}
    match_columns["v_mag"] = [None if m == NO_MAGNITUDE else d for m, d in zip(v_mag, _decimal(v_mag, 4), strict=True)]
    for name in MATCH_FIELDS[3:]:
        values = reader.numbers("<f4", matches)
        match_columns[name] = [
            None if missing else value for missing, value in zip(np.isnan(values), _shortest(values), strict=True)
        ]
    match_columns["name"] = reader.texts()
    for index, match in zip(match_indices.tolist(), zip(*match_columns.values(), strict=True), strict=True):
        rows[index] |= dict(zip(match_columns, match, strict=True))
    return rows


def _count(count: int) -> bytes:
    return np.array([count], "<u4").tobytes()


def _decimal(values: NDArray[Any], digits: int) -> list[float]:
    """Return integer multiples of 10**-digits as the nearest float64. For example, 2.06 remains 2.06."""
    return [value / 10**digits for value in values.tolist()]


def _shortest(values: NDArray[Any]) -> list[float]:
    """Return float32 values as float64 with at most seven digits. For example, 0.1 remains 0.1."""
    return [float(str(value)) for value in values]


class _DetailReader:
    """Reader of arrays and texts in the order in which they were written."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def numbers(self, dtype: str, count: int) -> NDArray[Any]:
        values = np.frombuffer(self._data, dtype, count, self._at)
        self._at += values.nbytes
        return values

    def count(self) -> int:
        return int(self.numbers("<u4", 1)[0])

    def texts(self) -> list[str]:
        size = self.count()
        strings: list[str] = json.loads(self._data[self._at : self._at + size])
        self._at += size
        return strings

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from gss.domain.errors import CorruptData
from gss.domain.json_object import JsonObject
from gss.store.compression import byte_planes, items_of_planes, zstd

POSITION_STEP_PX = 1e-5
MAGNITUDE_STEP = 1e-4
NO_MAGNITUDE = np.iinfo(np.int32).min
LARGEST, MAX_FLOAT = float(1 << 31), 3e38
PACKED = "packed_zstd"
ITEM_BYTES = 4
"""Size of a number. The packed block is filled to a multiple of this size."""
Rows = list[JsonObject]
BOUNDS = ("col_min", "row_min", "col_max", "row_max", "area_px")
CENTROID_FIELDS = ("index", "col_px", "row_px", "flux_dn", "peak_dn", "area_px")
CENTROID_COLUMNS = len(CENTROID_FIELDS) - 1
"""Stored columns of four bytes per centroid; the index is not stored."""
MATCH_FIELDS = ("hip", "name", "v_mag", "dx_px", "dy_px", "dx_arcsec", "dy_arcsec", "weight")


@dataclass(frozen=True)
class RegionColumns:
    """Regions of a frame. ``bounds`` (n, 5): see :data:`BOUNDS`; ``peak_dn`` (n,); ``rejected``: reasons."""

    bounds: NDArray[Any]
    peak_dn: NDArray[Any]
    rejected: Sequence[str]

    @classmethod
    def of_rows(cls, rows: Rows) -> RegionColumns:
        """Raises KeyError if a row has other fields."""
        if any(set(row) != {*BOUNDS, "peak_dn", "rejected"} for row in rows):
            raise KeyError
        bounds = np.array([[row[name] for name in BOUNDS] for row in rows], float)
        peak_dn = np.array([row["peak_dn"] for row in rows], float)
        return cls(bounds, peak_dn, [str(row["rejected"]) for row in rows])

    def rows(self) -> Rows:
        """Return the regions as plain rows."""
        columns = (*self.bounds.T.astype(int).tolist(), self.peak_dn.tolist(), self.rejected)
        names = (*BOUNDS, "peak_dn", "rejected")
        return [dict(zip(names, values, strict=True)) for values in zip(*columns, strict=True)]

    def text(self) -> str:
        """Return the packed regions. Raises ValueError if a number is out of range."""
        bounds, peak_dn = _integers(self.bounds.T), _floats(self.peak_dn)
        return _text([_count(len(self.rejected)), bounds, peak_dn, _texts(self.rejected)])


@dataclass(frozen=True)
class StarColumns:
    """Measured stars of a frame. ``measured`` (n, 5): see :data:`CENTROID_FIELDS` without the index; ``index`` (m,):
    rows of the matched stars; ``hip`` (m,) and ``name``; ``numbers`` (m, 6): magnitude, residual in column and row, px and
    arcsec, and weight, NaN if unknown."""

    measured: NDArray[Any]
    index: NDArray[Any]
    hip: NDArray[Any]
    name: Sequence[str]
    numbers: NDArray[Any]

    @classmethod
    def of_rows(cls, rows: Rows) -> StarColumns:
        """Raises KeyError if a row has other fields, ValueError if the indices are not in order."""
        if any(set(row) != ({*CENTROID_FIELDS, *MATCH_FIELDS} if "hip" in row else {*CENTROID_FIELDS}) for row in rows):
            raise KeyError
        if [row["index"] for row in rows] != list(range(len(rows))):
            raise ValueError("index")
        matched = [row for row in rows if "hip" in row]
        measured = np.array([[row[name] for name in CENTROID_FIELDS[1:]] for row in rows], float)
        numbers = np.array([[row[name] for name in MATCH_FIELDS[2:]] for row in matched], float)
        return cls(
            measured,
            np.array([row["index"] for row in matched], int),
            np.array([row["hip"] for row in matched], int),
            [str(row["name"]) for row in matched],
            numbers.reshape(len(matched), len(MATCH_FIELDS) - 2),
        )

    def rows(self) -> Rows:
        """Return the stars as plain rows. An unknown number is None."""
        rows: Rows = [
            {"index": k, "col_px": col, "row_px": row, "flux_dn": flux, "peak_dn": peak, "area_px": int(area)}
            for k, (col, row, flux, peak, area) in enumerate(self.measured.tolist())
        ]
        matches = zip(self.index.tolist(), self.hip.tolist(), self.name, self.numbers.tolist(), strict=True)
        for k, hip, name, numbers in matches:
            known = [value if math.isfinite(value) else None for value in numbers]
            rows[k] |= dict(zip(MATCH_FIELDS, (hip, name, *known), strict=True))
        return rows

    def text(self) -> str:
        """Return the packed stars. Raises ValueError if a number is out of range."""
        pixels, flux_and_peak, area_px = self.measured[:, :2], self.measured[:, 2:4], self.measured[:, 4]
        columns = [_integers(pixels.T, POSITION_STEP_PX), _floats(flux_and_peak.T), _integers(area_px)]
        columns += [_count(len(self.index)), self.index.astype("<u4").tobytes(), _integers(self.hip)]
        columns += [_integers(self.numbers[:, 0], MAGNITUDE_STEP, NO_MAGNITUDE)]
        columns += [_floats(self.numbers[:, 1:].T, missing=True)]
        return _text([_count(len(self.measured)), *columns, _texts(self.name)])


def _plain_block(text: str) -> bytes:
    return items_of_planes(zstandard.ZstdDecompressor().decompress(b64decode(text)), ITEM_BYTES)


DECODERS: dict[str, Callable[[str], bytes]] = {
    PACKED: _plain_block,
    "packed64": lambda text: zlib.decompress(b64decode(text)),
    "packed": lambda text: zlib.decompress(b85decode(text)),
}
"""Keys of packed lists, and the decoder of their text. The second and third form were written earlier."""


def packed(detail: Mapping[str, Any]) -> JsonObject:
    """Return the document with packed lists. ``regions`` and ``stars`` are columns or plain rows. Rows without the
    expected fields, or with a number out of range, stay plain, and a packed document stays unchanged."""
    texts: dict[str, str] = {}
    plain = dict(detail)
    for name, columns_of in (("regions", RegionColumns.of_rows), ("stars", StarColumns.of_rows)):
        stated = plain.get(name)
        if not stated:
            continue
        try:
            columns = columns_of(stated) if isinstance(stated, list) else stated
            texts[name] = columns.text()
            del plain[name]
        except (KeyError, TypeError, ValueError, OverflowError):  # other fields, or a number out of range
            continue
    return with_rows(plain) | {PACKED: texts} if texts else with_rows(plain)


def with_rows(detail: Mapping[str, Any]) -> JsonObject:
    """Return the document with plain rows instead of columns."""
    return {
        name: value.rows() if isinstance(value, RegionColumns | StarColumns) else value
        for name, value in detail.items()
    }


@contextmanager
def _damage_reported(name: str) -> Iterator[None]:
    """Raise CorruptData for a packed list that cannot be read."""
    try:
        yield
    except (ValueError, IndexError, MemoryError, zlib.error, zstandard.ZstdError) as error:
        raise CorruptData(f"the stored {name} of a solution are damaged", got=str(error) or "a huge size") from None


def unpacked(detail: JsonObject) -> JsonObject:
    """Return the document with plain lists. Raises CorruptData if they are damaged."""
    key = next((key for key in DECODERS if key in detail), None)
    if key is None:
        return detail
    plain = {name: value for name, value in detail.items() if name != key}
    for name, unpack in (("regions", _unpack_regions), ("stars", _unpack_stars)):
        if name in detail[key]:
            with _damage_reported(name):
                plain[name] = unpack(_DetailReader(DECODERS[key](detail[key][name])))
    return plain


def residuals_px(detail: Mapping[str, Any]) -> dict[int, float | None]:
    """Return the Hipparcos number of each matched star with the distance between its measured and predicted position, None
    if it is not stored. Reads a packed document without building its rows."""
    key = next((key for key in DECODERS if "stars" in detail.get(key, {})), None)
    if key is None:
        offsets = [
            (star["hip"], star.get("dx_px"), star.get("dy_px")) for star in detail.get("stars", []) if "hip" in star
        ]
        return {hip: None if dx is None or dy is None else math.hypot(dx, dy) for hip, dx, dy in offsets}
    with _damage_reported("stars"):
        return _packed_residuals_px(_DetailReader(DECODERS[key](detail[key]["stars"])))


def _packed_residuals_px(reader: _DetailReader) -> dict[int, float | None]:
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
    block = b"".join(parts)
    block += b" " * (-len(block) % ITEM_BYTES)  # the last part is JSON, which can end with spaces
    # Planes save a tenth of the space. A higher level saves 2 % and takes a third more time.
    return b64encode(zstd(byte_planes(block, ITEM_BYTES))).decode("ascii")


def _integers(values: NDArray[Any], step: float = 1.0, missing: int | None = None) -> bytes:
    """Return numbers in multiples of ``step`` as the bytes of an int32 array, row by row. ``missing``: stored instead of NaN.
    Raises ValueError if a number is out of range, or is missing although ``missing`` is None."""
    steps = np.round(np.asarray(values, float) / step)
    known = np.abs(steps) < LARGEST  # also false for NaN
    if not known.all():
        if missing is None or not (known | np.isnan(steps)).all():
            raise ValueError(values)
        steps = np.where(known, steps, missing)
    return steps.astype("<i4").tobytes()


def _floats(values: NDArray[Any], *, missing: bool = False) -> bytes:
    """Return numbers as the bytes of a float32 array, row by row. Raises ValueError if a number is out of range, or is
    missing although ``missing`` is false."""
    known = np.abs(values) < MAX_FLOAT  # also false for NaN
    if not known.all() and not (missing and (known | np.isnan(values)).all()):
        raise ValueError(values)
    return values.astype("<f4").tobytes()


def _texts(texts: Sequence[str]) -> bytes:
    data = json.dumps(list(texts), ensure_ascii=False, separators=(",", ":")).encode()
    return np.array([len(data)], "<u4").tobytes() + data


def _unpack_regions(reader: _DetailReader) -> Rows:
    count = reader.count()
    columns = {name: reader.numbers("<i4", count).tolist() for name in BOUNDS}
    columns["peak_dn"] = _shortest(reader.numbers("<f4", count))
    columns["rejected"] = reader.texts()
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


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

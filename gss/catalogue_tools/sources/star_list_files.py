"""Read star list files (CSV, ECSV, FITS, VOTable) as plain columns, with the units, epoch and frame that they state."""

from __future__ import annotations

import csv
import io
import itertools
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.sources.star_list_guards import (
    check_column_names,
    check_ecsv_header,
    check_lines,
    check_quotes,
    check_table_size,
    check_unit,
    check_votable,
    require_columns,
)
from gss.domain.errors import BadInput

MAX_EXTENSIONS = 100
# First bytes of compressed files. The libraries would decompress them automatically, to any size.
PACKED = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"PK\x03\x04", b"\x1f\x9d")
EPOCH_KEYS = ("epoch_jyear", "epochjy", "epoch", "posepoch")
CAMERA_KEYS = ("camera", "profile")
FRAME_KEYS = ("frame", "radesys", "coordsys", "system")
FRAME_WORDS = {
    "icrs": "icrs",
    "gcrs": "icrs",
    "fk5": "fk5",
    "eqfk5": "fk5",
    "fk4": "b1950",
    "eqfk4": "b1950",
    "b1950": "b1950",
}


@dataclass
class RawList:
    """Columns as in the file: numbers with NaN for empty values, or text.

    ``rows``: (n,) row numbers, counted from 1 after the header. ``broken``: (row, reason, text) of malformed rows.
    """

    columns: dict[str, NDArray[Any]]
    rows: NDArray[np.int64]
    units: dict[str, str] = field(default_factory=dict)
    epoch: str | None = None
    frame: str | None = None
    camera: str | None = None
    broken: list[tuple[int, str, str]] = field(default_factory=list)


def read_columns(data: bytes, kind: str) -> RawList:
    """Read all columns of a file. Raises BadInput if the file is not of that kind."""
    readers = {"csv": _csv, "ecsv": _ecsv, "fits": _fits, "votable": _votable}
    if kind not in readers:
        raise BadInput("unknown kind of star list", expected=" | ".join(readers), got=str(kind))
    if not data.strip():
        raise BadInput("the star list is empty", expected=f"a {kind} table with one row per star", got="an empty file")
    if data.startswith(PACKED):
        raise BadInput(
            "the star list is compressed",
            expected=f"a {kind} file",
            got="gzip, bzip2, xz or zip",
            hint="unpack it first",
        )
    try:
        raw = readers[kind](data)
    except (BadInput, MemoryError):
        raise
    except Exception as error:  # each library raises different exceptions for an invalid file
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BadInput(f"the star list is not a {kind} table", expected=f"a {kind} file", got=text[:200]) from None
    check_column_names(list(raw.columns))
    check_table_size(len(raw.rows), 0)
    return raw


def frame_word(text: str) -> str | None:
    """Return the GSS name of a frame named in a file; None if it is not supported."""
    return FRAME_WORDS.get(re.sub(r"[^a-z0-9]", "", text.lower()))


def _stated(meta: Mapping[str, Any], keys: Iterable[str]) -> str | None:
    plain = {str(k).lower(): v for k, v in meta.items()}
    for key in keys:
        value = plain.get(key)
        if isinstance(value, list | tuple | set | dict):
            raise BadInput(
                f"{key} of the star list is not one value", expected="a word or a number", got="a collection"
            )
        if value is not None and str(value) != "":
            return str(value)
    return None


def _csv(data: bytes) -> RawList:
    """Read a text table separated by comma, semicolon or tab. Lines that begin with # can state ``epoch_jyear = …``,
    ``frame = …`` and ``camera = …``."""
    text = _text(data)
    meta: dict[str, str] = {}
    start = 0
    while text.startswith("#", start):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        if stated := _statement(text[start + 1 : end]):
            meta[stated[0]] = stated[1]
        start = end + 1
    raw = _delimited(text[start:], None)
    raw.epoch, raw.frame = _stated(meta, EPOCH_KEYS), _stated(meta, FRAME_KEYS)
    raw.camera = _stated(meta, CAMERA_KEYS)
    return raw


def _statement(comment: str) -> tuple[str, str] | None:
    """Return name and value of a comment ``name = value`` or ``name: value``; None for other comments."""
    end = next((k for k, sign in enumerate(comment) if sign in "=:"), len(comment))
    name, value = comment[:end].strip(), comment[end + 1 :].strip()
    return (name, value) if name.replace("_", "a").isalnum() and value else None


def _ecsv(data: bytes) -> RawList:
    from astropy.table import meta as astropy_meta  # imported here because it takes a second

    text = _text(data)
    if not text.startswith("# %ECSV"):
        raise BadInput(
            "the star list is not an ecsv table", expected="# %ECSV in the first line", got=text[:40].split("\n")[0]
        )
    lines = []
    start = 0
    while text.startswith("#", start):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        lines.append(text[start + 2 : end].rstrip("\r"))
        start = end + 1
    check_ecsv_header(lines)
    header = astropy_meta.get_header_from_yaml(lines)
    raw = _delimited(text[start:], header.get("delimiter", " "))
    raw.units = {c["name"]: str(c["unit"]) for c in header.get("datatype", []) if c.get("unit")}
    meta = dict(header.get("meta") or {})
    raw.epoch, raw.frame = _stated(meta, EPOCH_KEYS), _stated(meta, FRAME_KEYS)
    raw.camera = _stated(meta, CAMERA_KEYS)
    return raw


def _text(data: bytes) -> str:
    check_lines(data)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(
            "the star list is not text", expected="UTF-8", got=f"byte {data[error.start]:#04x} at {error.start}"
        ) from None


def _delimited(text: str, delimiter: str | None) -> RawList:
    """Parse the columns of a text table. Rows with too many or too few values are recorded as broken."""
    import pyarrow as pa  # imported here because it takes half a second
    import pyarrow.csv as arrow_csv

    text = text.lstrip("\r\n")
    first = text.split("\n", 1)[0].rstrip("\r")
    mark = delimiter or max(",;\t", key=first.count)
    names = [name.strip() for name in next(csv.reader([first], delimiter=mark), [])]
    check_column_names(names)
    check_quotes(text, mark)
    broken: list[tuple[int, str, str]] = []

    def note(row: Any) -> str:
        broken.append(
            (
                int(row.number) - 1,
                f"{row.actual_columns} values, the header names {row.expected_columns}",
                row.text[:60],
            )
        )
        return "skip"

    table = arrow_csv.read_csv(
        io.BytesIO(text.encode()),
        read_options=arrow_csv.ReadOptions(use_threads=False, column_names=names, skip_rows=0, block_size=1 << 24),
        parse_options=arrow_csv.ParseOptions(delimiter=mark, invalid_row_handler=note, newlines_in_values=False),
        convert_options=arrow_csv.ConvertOptions(
            column_types={name: pa.string() for name in names}, strings_can_be_null=False
        ),
    ).slice(1)
    count = table.num_rows + len(broken)
    complete = np.ones(count, bool)
    complete[[number - 1 for number, _, _ in broken]] = False
    rows = np.flatnonzero(complete) + 1
    return RawList({name: _numbers_or_text(table.column(name)) for name in names}, rows, broken=broken)


def _numbers_or_text(column: Any) -> NDArray[Any]:
    """Convert a text column to whole numbers if possible, otherwise to numbers with NaN for empty values, otherwise
    return it as text."""
    import pyarrow as pa
    import pyarrow.compute as arrow_compute

    trimmed = arrow_compute.utf8_trim_whitespace(column)
    for kind in (pa.int64(), pa.float64()):
        filled = trimmed
        if kind == pa.float64():
            empty = arrow_compute.equal(trimmed, "")
            filled = arrow_compute.if_else(empty, pa.scalar(None, pa.string()), trimmed)
        try:
            return np.asarray(arrow_compute.cast(filled, kind).to_numpy())
        except pa.ArrowInvalid:
            continue
    return np.asarray(column.to_numpy(), object)


def _fits(data: bytes) -> RawList:
    from astropy.io import fits
    from astropy.table import Table

    with fits.open(io.BytesIO(data), memmap=False) as files:
        extensions = itertools.islice(files, MAX_EXTENSIONS)
        first = next((hdu for hdu in extensions if isinstance(hdu, fits.BinTableHDU | fits.TableHDU)), None)
        if first is None:
            raise BadInput("the FITS file contains no table", expected="a binary table", got=f"{len(files)} extensions")
        _check_fits_table(first.header)
        table = Table.read(first)
        header = {**dict(files[0].header), **dict(first.header)}
    raw = _of_astropy(table)
    raw.epoch, raw.frame = _stated(header, EPOCH_KEYS), _stated(header, FRAME_KEYS)
    raw.camera = _stated(header, CAMERA_KEYS)
    return raw


def _check_fits_table(header: Mapping[str, Any]) -> None:
    """Check the table size in the header before memory is allocated."""
    count = int(header["TFIELDS"])
    require_columns(count)
    check_table_size(int(header["NAXIS2"]), int(header["NAXIS1"]))
    for k in range(1, count + 1):
        check_unit(str(header.get(f"TUNIT{k}", "")))


def _votable(data: bytes) -> RawList:
    from astropy.io import votable

    check_votable(data)
    file = votable.parse(io.BytesIO(data), verify="ignore", table_number=0)
    first = next(file.iter_tables(), None)
    if first is None:
        raise BadInput("the VOTable contains no table", expected="a TABLE element", got="none")
    raw = _of_astropy(first.to_table(use_names_over_ids=True))
    stated = {info.name: info.value for resource in file.resources for info in (*resource.infos, *resource.params)}
    stated |= {info.name: info.value for info in (*first.infos, *first.params)}
    systems = [s for resource in file.resources for s in resource.coordinate_systems] + list(file.coordinate_systems)
    raw.epoch = _stated(stated, EPOCH_KEYS) or next((str(s.epoch) for s in systems if s.epoch), None)
    raw.camera = _stated(stated, CAMERA_KEYS)
    raw.frame = _stated(stated, FRAME_KEYS) or next((str(s.system) for s in systems if s.system), None)
    return raw


def _of_astropy(table: Any) -> RawList:
    columns: dict[str, NDArray[Any]] = {}
    for name in table.colnames:
        values = table[name]
        mask = np.asarray(getattr(values, "mask", False))
        plain = np.asarray(values)
        if plain.ndim != 1:
            continue
        if plain.dtype.kind in "iufb" and mask.any():
            plain = np.where(mask, np.nan, plain.astype(float))
        elif plain.dtype.kind == "S":
            plain = np.array([text.decode("utf-8", "replace") for text in plain], object)
        columns[name] = plain if plain.dtype.kind in "iufbc" else plain.astype(object)
    units = {name: str(table[name].unit) for name in columns if table[name].unit is not None}
    return RawList(columns, np.arange(1, len(table) + 1), units)

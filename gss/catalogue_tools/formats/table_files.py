"""Convert a bank image to table files of other programs and back, byte for byte. For FITS the result is one file. For
CSV, ECSV and Parquet it is a ZIP with one file per table, because a file of these formats contains a single table.

Every block of the image is a table or a column of a table, in the device's number types (see
docs/catalogue-formats.md). Header and section heads are tables of bytes. ``layout`` states the order of the blocks in
the image. The conversion is lossless: all digits of single precision are written, and packed entries become whole
numbers.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import zipfile
from collections.abc import Callable, Mapping
from typing import Any, TypedDict

import numpy as np

from gss.catalogue_tools.formats.blocks import Block, Columns, block_columns, dtype_of, to_bytes
from gss.catalogue_tools.formats.registry import blocks_of, decode, read_header
from gss.catalogue_tools.sources.star_list_guards import check_ecsv_header
from gss.domain.errors import BadInput, CorruptData

LAYOUT = "layout"
LAYOUT_FILE = "layout.json"
MAX_BYTES = 1 << 28
DATE = (1980, 1, 1, 0, 0, 0)
Tables = dict[str, Columns]


def export_table(image: bytes, kind: str) -> bytes:
    """Check a bank image and return it as a file. ``kind``: fits, csv, ecsv or parquet; the last three are ZIP
    files."""
    decode(image)
    tables, layout = _tables(image)
    facts = _facts(image)
    if _check(kind) == "fits":
        return _write_fits(tables, layout, facts)
    return _zipped({f"{name}.{kind}": WRITERS[kind](name, c, facts) for name, c in tables.items()}, layout, facts)


def import_table(data: bytes, kind: str) -> bytes:
    """Return the bank image in a file written by :func:`export_table` after verifying its checksums.

    Raises BadInput if it is not such a file, and CorruptData if a table, a column or a number was changed.
    """
    layout, read = (_read_fits if _check(kind) == "fits" else _read_zip)(data, kind)
    image = b""
    for name, block in layout:
        columns = read(name)
        image += _bytes_of(name, block, columns)
    decode(image)
    described_bytes = sum(len(data) for _, data in blocks_of(image))
    if described_bytes != len(image):
        raise CorruptData(
            "the table file does not contain one complete image",
            expected=f"{described_bytes} bytes",
            got=f"{len(image)} bytes",
        )
    return image


def _check(kind: str) -> str:
    if kind not in KINDS:
        raise BadInput("unknown kind of table file", expected=" | ".join(KINDS), got=kind)
    return kind


def _facts(image: bytes) -> dict[str, object]:
    h = read_header(image)
    return {
        "format": h.format_name,
        "profile": h.profile_name,
        "stars": h.stars,
        "pairs": h.pairs,
        "epoch": h.epoch_jyear,
    }


class BlockEntry(TypedDict):
    """Entry of a block in the layout of the files. ``type``: numpy type. ``bits``: widths of packed fields."""

    table: str
    name: str
    type: str | list[Any]
    shape: list[int]
    bits: list[int]
    rows: int


def _tables(image: bytes) -> tuple[Tables, list[BlockEntry]]:
    """Return the columns by table, and for each block its table, names, type, shape, bits and count."""
    tables: Tables = {}
    layout: list[BlockEntry] = []
    for block, data in blocks_of(image):
        if not block.size:
            continue
        name = block.table if block.table != "raw" else f"bytes_{block.name.lower()}"
        columns = block_columns(block, data)
        tables.setdefault(name, {}).update(columns)
        dtype = block.dtype.descr if block.dtype.names else block.dtype.base.str
        shape, bits = list(block.dtype.shape), list(block.bits)
        layout.append(
            {"table": name, "name": block.name, "type": dtype, "shape": shape, "bits": bits, "rows": block.count}
        )
    return tables, layout


def _block(entry: Mapping[str, Any]) -> tuple[str, Block]:
    dtype = dtype_of(entry["type"], entry["shape"])
    rows, bits = entry["rows"], tuple(entry["bits"])
    if not all(type(number) is int and number > 0 for number in (rows, *bits)) or len(bits) not in (
        0,
        len(str(entry["name"]).split()),
    ):
        raise ValueError(f"a block of {rows!r} rows with bits {bits!r}"[:200])
    return str(entry["table"]), Block("", dtype, rows, str(entry["name"]), bits)


def _parsed_layout(text: str) -> list[tuple[str, Block]]:
    try:
        return [_block(entry) for entry in json.loads(text)]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise CorruptData("the layout of the table file is damaged", expected="its JSON", got=str(error)) from None


def _bytes_of(name: str, block: Block, columns: Columns) -> bytes:
    names = block.name.split() if block.bits else block.dtype.names or (block.name,)
    missing = [n for n in names if n not in columns]
    lengths = {len(columns[n]) for n in names if n in columns}
    if missing or lengths - {block.count}:
        got = f"no {', '.join(missing)}" if missing else f"{sorted(lengths)} rows"
        raise CorruptData(f"table {name} is incomplete", expected=f"{', '.join(names)}, {block.count} rows", got=got)
    for i, column in enumerate(names):
        target = block.dtype[column] if block.dtype.names else block.dtype.base
        if target.kind in "iu":
            limits = np.iinfo(target)
            low, high = (0, 2 ** block.bits[i] - 1) if block.bits else (int(limits.min), int(limits.max))
            _require_whole(f"column {column} of table {name}", columns[column], low, high)
    try:
        return to_bytes([block], columns)
    except (ValueError, OverflowError) as error:
        raise CorruptData(f"table {name} contains a value that does not fit its type", got=str(error)) from None


def _require_whole(quantity: str, values: np.ndarray[Any, Any], low: int, high: int) -> None:
    """Raise CorruptData unless all values are whole numbers in the range of the type. A cast would silently convert NaN
    to 0 and wrap 256 in a byte."""
    is_whole = values.dtype.kind in "iu" or (values.dtype.kind == "f" and bool(np.all(values == np.floor(values))))
    if len(values) and not (is_whole and low <= values.min() and values.max() <= high):
        raise CorruptData(
            f"{quantity} contains a value that does not fit its type",
            expected=f"whole numbers of {low} to {high}",
            got=f"{values.min()} to {values.max()}",
        )


# --- FITS -----------------------------------------------------------------------------------------------------------


def _write_fits(tables: Tables, layout: list[BlockEntry], facts: Mapping[str, Any]) -> bytes:
    from astropy.io import fits
    from astropy.table import Table  # imported here because it takes a second

    primary = fits.PrimaryHDU()
    primary.header.update({f"{name[:8].upper()}": value for name, value in facts.items()})
    order = np.frombuffer(json.dumps(layout).encode(), np.uint8)
    hdus = [primary, fits.table_to_hdu(Table({"json": order}))]
    hdus[1].name = LAYOUT.upper()
    for name, columns in tables.items():
        hdu = fits.table_to_hdu(Table({n: v.astype(v.dtype.newbyteorder("=")) for n, v in columns.items()}))
        hdu.name = name.upper()
        hdus.append(hdu)
    file = io.BytesIO()
    fits.HDUList(hdus).writeto(file, checksum=True)
    return file.getvalue()


def _read_fits(data: bytes, kind: str) -> tuple[list[tuple[str, Block]], Callable[[str], Columns]]:
    from astropy.io import fits

    try:
        with fits.open(io.BytesIO(data), memmap=False) as hdus:
            tables = {
                hdu.name.lower(): {n: np.asarray(hdu.data[n]) for n in hdu.columns.names}
                for hdu in hdus[1:]
                if isinstance(hdu, fits.BinTableHDU)
            }
    except MemoryError:
        raise
    except Exception as error:  # readers raise arbitrary exceptions for malformed files
        raise BadInput("not a FITS file", expected="a FITS file that GSS exported", got=str(error)) from None
    if LAYOUT not in tables or tables[LAYOUT].get("json", np.empty(0)).dtype.kind not in "iu":
        raise BadInput("not a catalogue in FITS tables", expected="a LAYOUT table", got=", ".join(tables), hint=HINT)
    text = tables[LAYOUT]["json"].astype(np.uint8).tobytes().decode("utf-8", "replace")
    return _parsed_layout(text), lambda name: _required_table(tables, name)


def _required_table(tables: Tables, name: str) -> Columns:
    if name not in tables:
        raise CorruptData("a table is missing", expected=name, got=", ".join(tables))
    return tables[name]


# --- one file per table, in a ZIP ------------------------------------------------------------------------------------


def _zipped(files: Mapping[str, bytes], layout: list[BlockEntry], facts: Mapping[str, Any]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        content = {
            LAYOUT_FILE: json.dumps(layout, indent=1).encode(),
            "facts.json": json.dumps(facts).encode(),
            **files,
        }
        for name, data in content.items():
            # With a fixed date, the same catalogue always gives the same file.
            archive.writestr(zipfile.ZipInfo(name, DATE), data, zipfile.ZIP_DEFLATED)
    return file.getvalue()


def _read_zip(data: bytes, kind: str) -> tuple[list[tuple[str, Block]], Callable[[str], Columns]]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_BYTES:
                raise ValueError(f"more than {MAX_BYTES} bytes")
            files = {name: archive.read(name) for name in archive.namelist()}
    except MemoryError:
        raise
    except Exception as error:  # readers raise arbitrary exceptions for malformed files
        raise BadInput(
            "not a ZIP of tables", expected="a ZIP file that GSS exported", got=str(error), hint=HINT
        ) from None
    if LAYOUT_FILE not in files:
        raise BadInput("not a catalogue in a ZIP of tables", expected=LAYOUT_FILE, got=", ".join(files), hint=HINT)
    layout = _parsed_layout(files[LAYOUT_FILE].decode("utf-8", "replace"))
    read: dict[str, Columns] = {}

    def table(name: str) -> Columns:
        if name not in read:
            if f"{name}.{kind}" not in files:
                raise CorruptData("a table is missing", expected=f"{name}.{kind}", got=", ".join(files))
            try:
                read[name] = READERS[kind](files[f"{name}.{kind}"])
            except MemoryError:
                raise
            except Exception as error:  # readers raise arbitrary exceptions for malformed files
                raise CorruptData(f"table {name} cannot be read", expected=kind, got=str(error)) from None
        return read[name]

    return layout, table


def _write_csv(name: str, columns: Columns, facts: Mapping[str, Any]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    # numpy writes the shortest text from which the same number is restored.
    writer.writerows(zip(*([str(v) for v in values] for values in columns.values()), strict=True))
    return text.getvalue().encode()


def _read_csv(data: bytes) -> Columns:
    head, *rows = csv.reader(io.StringIO(data.decode()))
    cells = list(zip(*rows, strict=True)) if rows else [()] * len(head)
    return {n: _numbers(c) for n, c in zip(head, cells, strict=True)}


def _numbers(cells: tuple[str, ...]) -> np.ndarray[Any, Any]:
    all_integers = all(cell.lstrip("-").isdigit() for cell in cells)
    return (
        np.array([int(cell) for cell in cells], np.int64) if all_integers else np.array([float(cell) for cell in cells])
    )


def _write_ecsv(name: str, columns: Columns, facts: Mapping[str, Any]) -> bytes:
    from astropy.table import Table

    text = io.StringIO()
    table = Table({n: v.astype(v.dtype.newbyteorder("=")) for n, v in columns.items()}, meta={"table": name, **facts})
    table.write(text, format="ascii.ecsv")
    return text.getvalue().encode()


def _read_ecsv(data: bytes) -> Columns:
    from astropy.io import ascii as text_tables

    lines = data.decode().splitlines()
    check_ecsv_header([line[2:] for line in itertools.takewhile(lambda line: line.startswith("#"), lines)])
    table = text_tables.read(lines, format="ecsv", guess=False)
    return {n: np.asarray(table[n]) for n in table.colnames}


def _write_parquet(name: str, columns: Columns, facts: Mapping[str, Any]) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({n: v.astype(v.dtype.newbyteorder("=")) for n, v in columns.items()})
    table = table.replace_schema_metadata({"table": name} | {k: str(v) for k, v in facts.items()})
    file = io.BytesIO()
    pq.write_table(table, file)
    return file.getvalue()


def _read_parquet(data: bytes) -> Columns:
    import pyarrow.parquet as pq

    file = pq.ParquetFile(io.BytesIO(data))
    groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
    values = sum(group.column(k).num_values for group in groups for k in range(group.num_columns))
    if 8 * max(values, file.metadata.num_rows * file.metadata.num_columns) > MAX_BYTES:
        raise ValueError(f"{values} values, more than {MAX_BYTES} bytes")
    table = file.read()
    return {n: table[n].to_numpy() for n in table.column_names}


HINT = "only complete images can be imported this way; import a plain star list as a user's star list"
WRITERS: dict[str, Callable[[str, Columns, Mapping[str, Any]], bytes]] = {
    "csv": _write_csv,
    "ecsv": _write_ecsv,
    "parquet": _write_parquet,
}
READERS: dict[str, Callable[[bytes], Columns]] = {"csv": _read_csv, "ecsv": _read_ecsv, "parquet": _read_parquet}
KINDS = ("fits", *WRITERS)

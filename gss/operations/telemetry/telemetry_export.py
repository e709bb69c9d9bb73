"""Exports telemetry fields over a time span as CSV, Parquet or HDF5, block by block, with the values that pages
display."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import chain, islice
from typing import Any

from gss.domain.errors import BadInput
from gss.instruments.dictionary.definitions import INTEGER_RANGES, Group, TelemetryField
from gss.operations.telemetry.archive import Archive, Column
from gss.operations.telemetry.hdf5_export import hdf5_file
from gss.operations.telemetry.value_format import OTHER_VALUES, column_type, formatted, json_text, raw_of, typed
from gss.store.telemetry import Row

FORMATS = {
    "csv": "text/csv; charset=utf-8",
    "parquet": "application/vnd.apache.parquet",
    "hdf5": "application/x-hdf5",
}
FORMS = ("converted", "raw", "formatted")
LEADING = ("received", "device_time_s", "contact", "packet")
BLOCK_ROWS = 4000


def export(
    archive: Archive, keys: Sequence[str], start: datetime, end: datetime, *, form: str, file_format: str
) -> Iterator[bytes]:
    """Return the file in pieces; at most BLOCK_ROWS rows are in memory. Raises BadInput before the first piece.

    Columns: received (UTC), device_time_s, contact, packet, then one per key. ``form``: "converted" for stored
    engineering values, "raw" for transmitted values, "formatted" for displayed text. Values that the type of their column
    cannot hold, because their field had another definition, are unchanged in CSV; Parquet and HDF5 have them as JSON in the
    column OTHER_VALUES.
    """
    for name, value, valid in (("form", form, FORMS), ("format", file_format, tuple(FORMATS))):
        if value not in valid:
            raise BadInput(f"unknown {name}", expected=" | ".join(valid), got=value)
    columns, rows = archive.rows(keys, start, end)
    if file_format == "csv":
        pieces = _csv(columns, (_shaped(columns, row, values, form) for row, values in rows))
    else:
        typed_rows = (_typed_row(columns, row, values, form) for row, values in rows)
        if file_format == "hdf5":
            return hdf5_file(columns, typed_rows, form)
        pieces = _parquet(columns, typed_rows, form)
    return chain([next(pieces)], pieces)  # if the first block fails, no response has been sent


def _shaped(columns: Sequence[Column], row: Row, values: Sequence[Any], form: str) -> list[Any]:
    cells = [_in_form(c, value, form) for c, value in zip(columns, values, strict=True)]
    return [row.received, row.device_time_s or None, row.contact_id, row.packet, *cells]


def _typed_row(columns: Sequence[Column], row: Row, values: Sequence[Any], form: str) -> list[Any]:
    """Return a row with only the values that the types of the columns can hold, and a cell with the others as JSON."""
    others = {}
    if form != "formatted":
        others = {
            c.key: value
            for c, value in zip(columns, values, strict=True)
            if value is not None and not isinstance(c.field, Group) and typed(c.field, value) is None
        }
        values = [None if c.key in others else value for c, value in zip(columns, values, strict=True)]
    return [*_shaped(columns, row, values, form), json_text(others) if others else None]


def _in_form(column: Column, value: Any, form: str) -> Any:
    if value is None:
        return None
    if isinstance(column.field, Group):
        return json_text(value)
    in_type = typed(column.field, value)
    if form == "raw":
        return value if in_type is None else raw_of(column.field, in_type)
    value = value if in_type is None else in_type
    if form == "converted":
        return value
    return formatted(value, column.field.decimals if isinstance(column.field, TelemetryField) else 0)


def _csv(columns: Sequence[Column], rows: Iterator[list[Any]]) -> Iterator[bytes]:
    """Yield CSV by RFC 4180 with a header, times in ISO 8601 with Z, and empty cells for unknown values."""
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer)
    writer.writerow([*LEADING, *(c.key for c in columns)])
    while True:
        block = list(islice(rows, BLOCK_ROWS))
        for row in block:
            received = row[0].astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
            writer.writerow([received, *("" if v is None else _cell(v) for v in row[1:])])
        yield buffer.getvalue().encode()
        buffer.seek(0)
        buffer.truncate()
        if len(block) < BLOCK_ROWS:
            return


def _cell(value: Any) -> Any:
    return {True: "true", False: "false"}[value] if isinstance(value, bool) else value


class _Pieces(io.RawIOBase):
    """An append-only file object. ``take`` returns the written bytes in pieces."""

    def __init__(self) -> None:
        super().__init__()
        self._waiting = bytearray()
        self._at = 0

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        piece = bytes(data)
        self._waiting += piece
        self._at += len(piece)
        return len(piece)

    def tell(self) -> int:
        return self._at

    def take(self) -> bytes:
        """Return the bytes written since the last call."""
        piece = bytes(self._waiting)
        self._waiting.clear()
        return piece


def _parquet(columns: Sequence[Column], rows: Iterator[list[Any]], form: str) -> Iterator[bytes]:
    """Yield a Parquet file with one row group per block. The metadata of each column contains its unit and title."""
    import pyarrow as pa
    from pyarrow import parquet as pq

    leading = [pa.timestamp("us", tz="UTC"), pa.float64(), pa.int64(), pa.string()]
    fields = [pa.field(name, arrow_type) for name, arrow_type in zip(LEADING, leading, strict=True)]
    fields += [pa.field(c.key, _arrow_type(pa, c, form), metadata=_metadata(c)) for c in columns]
    fields.append(pa.field(OTHER_VALUES, pa.string()))
    schema = pa.schema(fields)
    sink = _Pieces()
    with pq.ParquetWriter(sink, schema, compression="snappy") as writer:
        while block := list(islice(rows, BLOCK_ROWS)):
            arrays = [pa.array(values, f.type) for values, f in zip(zip(*block, strict=True), schema, strict=True)]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            yield sink.take()
    yield sink.take()


def _arrow_type(pa: Any, column: Column, form: str) -> Any:
    """Return the Arrow type of a column. The type does not depend on the values, so files of different time spans can
    be read together."""
    item = column.field
    if isinstance(item, Group) or form == "formatted":
        return pa.string()
    if form == "raw" and item.type in (*INTEGER_RANGES, "enum"):
        return pa.uint64() if item.type == "u64" else pa.int64()
    return pa.type_for_alias(column_type(item))


def _metadata(column: Column) -> dict[str, str]:
    item = column.field
    if not isinstance(item, TelemetryField):
        return {"packet": column.packet}
    return {"packet": column.packet, "title": item.title, "unit": item.unit}

"""Exports telemetry as an HDF5 file: a group per packet, a dataset per field, with units and titles as attributes."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from itertools import islice
from typing import IO, TYPE_CHECKING, Any

from gss.domain.errors import StoreDown
from gss.instruments.dictionary.definitions import Group, TelemetryField
from gss.operations.telemetry.archive import Column
from gss.operations.telemetry.value_format import OTHER_VALUES, column_type

if TYPE_CHECKING:
    import h5py

BLOCK_ROWS = 4000
PIECE_BYTES = 256 * 1024
CHUNK_ROWS = 1024
SPARE_BYTES = 256 << 20
"""Space that an export leaves free on the disk of temporary files."""
LEADING = {
    "received": {"unit": "s", "title": "Unix time of reception, UTC"},
    "device_time_s": {"unit": "s", "title": "Time of the sensor's clock"},
    "contact": {"title": "Number of the contact, -1 without a contact"},
    OTHER_VALUES: {"title": "JSON of the values that the type of their dataset cannot hold"},
}
UNKNOWN_BOOL, NO_CONTACT = -1, -1
UNKNOWN_U64 = 2**64 - 1


def hdf5_file(columns: Sequence[Column], rows: Iterator[list[Any]], form: str) -> Iterator[bytes]:
    """Return the file in pieces. ``rows``: received, device_time_s, contact and packet, then a value per column, then
    the JSON of other values.
    Numbers are float64, NaN if unknown; numbers of the type u64 are uint64, and an attribute states the value for unknown;
    yes/no is int8, -1 if unknown; other values are text, empty if unknown. The complete file is written to the disk before this
    function returns, because HDF5 completes the beginning of a file at the end. At most BLOCK_ROWS rows are in memory. Raises
    StoreDown if the disk of temporary files has too little space."""
    import h5py

    with ExitStack() as stack:
        file = stack.enter_context(tempfile.TemporaryFile())
        with h5py.File(file, "w") as out:
            tables = {
                packet: _PacketTable(
                    out, packet, [k for k, c in enumerate(columns) if c.packet == packet], columns, form
                )
                for packet in dict.fromkeys(c.packet for c in columns)
            }
            while block := list(islice(rows, BLOCK_ROWS)):
                _check_room()
                for packet, table in tables.items():
                    table.append([row for row in block if row[3] == packet])
        stack.pop_all()
    return _pieces(file)


def _check_room() -> None:
    folder = tempfile.gettempdir()
    free_bytes = shutil.disk_usage(folder).free
    if free_bytes < SPARE_BYTES:
        raise StoreDown(
            "the disk of temporary files is nearly full: no room for an HDF5 export",
            expected=f"at least {SPARE_BYTES / 1e6:.0f} MB free in {folder}",
            got=f"{free_bytes / 1e6:.0f} MB",
            hint="export a shorter time range, use CSV or Parquet, or set TMPDIR to a larger disk",
        )


def _pieces(file: IO[bytes]) -> Iterator[bytes]:
    with file:
        file.seek(0)
        while piece := file.read(PIECE_BYTES):
            yield piece


class _PacketTable:
    """The datasets of one packet, which have equal length. ``positions``: positions of its columns in the rows."""

    def __init__(
        self, out: h5py.File, packet: str, positions: Sequence[int], columns: Sequence[Column], form: str
    ) -> None:
        # A field that is requested twice is written once.
        position_of = {_name(columns[k].field.name): k for k in positions}
        self._group = out.create_group(packet)
        self._names, self._positions = list(position_of), list(position_of.values())
        self._kinds = [_kind(columns[k], form) for k in self._positions]
        self._size = 0
        for name, dataset_kind in zip(
            [*LEADING, *self._names], ["number", "number", "contact", "text", *self._kinds], strict=True
        ):
            self._create(name, dataset_kind)
        for name, attributes in LEADING.items():
            self._group[name].attrs.update(attributes)
        for name, k in position_of.items():
            item = columns[k].field
            if isinstance(item, TelemetryField):
                self._group[name].attrs.update({"title": item.title, "unit": item.unit})

    def _create(self, name: str, dataset_kind: str) -> None:
        import h5py

        types = {"number": "f8", "u64": "u8", "bool": "i1", "contact": "i8", "text": h5py.string_dtype()}
        self._group.create_dataset(
            name,
            shape=(0,),
            maxshape=(None,),
            chunks=(CHUNK_ROWS,),
            dtype=types[dataset_kind],
            compression="gzip",
            shuffle=True,
        )
        if dataset_kind == "u64":
            self._group[name].attrs.create("unknown", UNKNOWN_U64, dtype="u8")

    def append(self, rows: Sequence[list[Any]]) -> None:
        """Append rows of this packet."""
        if not rows:
            return
        start, self._size = self._size, self._size + len(rows)
        self._write("received", start, [row[0].timestamp() for row in rows])
        self._write("device_time_s", start, [_number(row[1]) for row in rows])
        self._write("contact", start, [NO_CONTACT if row[2] is None else row[2] for row in rows])
        self._write(OTHER_VALUES, start, [_value("text", row[-1]) for row in rows])
        for name, dataset_kind, k in zip(self._names, self._kinds, self._positions, strict=True):
            values = [row[4 + k] for row in rows]
            self._write(name, start, [_value(dataset_kind, value) for value in values])

    def _write(self, name: str, start: int, values: list[Any]) -> None:
        dataset = self._group[name]
        dataset.resize((self._size,))
        dataset[start:] = values


def _name(field: str) -> str:
    """Return the name of a field's dataset, which must differ from the datasets in LEADING."""
    return f"{field}_value" if field in LEADING else field


def _kind(column: Column, form: str) -> str:
    item = column.field
    if isinstance(item, Group) or form == "formatted":
        return "text"
    if item.type == "u64" and form == "raw":
        return "u64"
    if form == "raw" and item.type == "enum":
        return "number"
    return {"uint64": "u64", "bool": "bool", "string": "text"}.get(column_type(item), "number")


def _value(dataset_kind: str, value: Any) -> Any:
    if dataset_kind == "number":
        return _number(value)
    if dataset_kind == "u64":
        return UNKNOWN_U64 if value is None else value
    if dataset_kind == "bool":
        return UNKNOWN_BOOL if value is None else int(value)
    return "" if value is None else str(value).replace("\0", "\N{REPLACEMENT CHARACTER}")  # HDF5 cannot store NUL


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)

"""Exports the store as Parquet files in hive-style folders
(``telemetry/packet=housekeeping/day=2026-12-01/part-0.parquet``), readable by DuckDB, pandas and pyarrow. Units are in
each column's metadata, and in schema.json and README.md."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from itertools import groupby
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import parquet as pq

from gss import __version__
from gss.domain.callbacks import no_progress
from gss.domain.errors import BadInput
from gss.instruments.dictionary.definitions import Group, Item, TelemetryField
from gss.operations.frames.solution_export import SCHEMA as SOLUTIONS
from gss.operations.frames.solution_export import as_row
from gss.operations.telemetry.field_definitions import TelemetryDefinitions
from gss.operations.telemetry.value_format import OTHER_VALUES, column_type, json_text, typed
from gss.store import exports as store
from gss.store.engine import Database

FIRST_DAY, LAST_DAY = date(1970, 1, 1), date(9999, 12, 30)
MOMENT = pa.timestamp("us", tz="UTC")
OnFolder = Callable[[str], None]

LEADING = pa.schema(
    [
        ("received", MOMENT),
        ("id", pa.int64()),
        ("contact_id", pa.int64()),
        pa.field("device_time_s", pa.float64(), metadata={"unit": "s"}),
        ("request_id", pa.int64()),
    ]
)
STARS = pa.schema(
    [
        ("created", MOMENT),
        ("solution_id", pa.int64()),
        ("frame_id", pa.int64()),
        ("chain", pa.string()),
        ("index", pa.int64()),
        ("hip", pa.int64()),
        ("name", pa.string()),
        *(
            pa.field(name, pa.float64(), metadata={"unit": unit})
            for name, unit in (
                ("col_px", "px"),
                ("row_px", "px"),
                ("flux_dn", "DN"),
                ("peak_dn", "DN"),
                ("area_px", "px"),
                ("v_mag", "mag"),
                ("dx_px", "px"),
                ("dy_px", "px"),
                ("dx_arcsec", "arcsec"),
                ("dy_arcsec", "arcsec"),
                ("weight", ""),
            )
        ),
    ]
)
COMMANDS = pa.schema(
    [
        ("created", MOMENT),
        ("id", pa.int64()),
        ("contact_id", pa.int64()),
        ("request_id", pa.int64()),
        ("name", pa.string()),
        ("user", pa.string()),
        ("source", pa.string()),
        ("finished", MOMENT),
        ("result", pa.string()),
        ("detail", pa.string()),
        ("late", pa.bool_()),
        ("attempts", pa.int64()),
        ("resolved_note", pa.string()),
        ("arguments", pa.string()),
        ("values", pa.string()),
        ("stages", pa.list_(pa.struct([("stage", pa.string()), ("at", MOMENT), ("detail", pa.string())]))),
    ]
)
EVENTS = pa.schema(
    [
        ("at", MOMENT),
        ("seq", pa.int64()),
        ("kind", pa.string()),
        ("severity", pa.string()),
        ("text", pa.string()),
        ("data", pa.string()),
    ]
)
UNITS = {"_arcsec": "arcsec", "_deg": "deg", "_px": "px", "_ms": "ms", "_s": "s"}


@dataclass(frozen=True)
class Written:
    """Numbers of written files, rows and bytes."""

    files: int
    rows: int
    bytes: int


@dataclass(frozen=True)
class _Table:
    """One output folder. ``schema``: its columns; ``blocks``: blocks of (time, row), oldest first."""

    folder: str
    schema: pa.Schema
    blocks: Iterator[list[tuple[datetime, dict[str, object]]]]


def export_parquet(
    database: Database,
    dictionary: TelemetryDefinitions,
    out: Path,
    first: date | None = None,
    last: date | None = None,
    on_folder: OnFolder = no_progress,
) -> Written:
    """Export complete UTC days from ``first`` to ``last``, inclusive, into ``out``. Existing days are replaced. At most
    one block of rows is in memory. A file gets its final name when it is complete. Raises BadInput if ``out`` contains
    other files."""
    start, end = first or FIRST_DAY, last or LAST_DAY
    if end < start:
        raise BadInput("the time span is empty", expected="a start before the end", got=f"{start} … {end}")
    if out.exists() and any(out.iterdir()) and not (out / "schema.json").is_file():
        raise BadInput("the folder contains other files", expected="a new folder, or an older export", got=str(out))
    out.mkdir(parents=True, exist_ok=True)
    # The file marks the folder as an export, so that an interrupted export can be repeated.
    (out / "schema.json").write_text("{}\n", "utf-8")
    span = datetime.combine(start, time(), UTC), datetime.combine(end, time(), UTC) + timedelta(days=1)
    written, schemas = Written(0, 0, 0), {}
    for table in _tables(database, dictionary, *span):
        on_folder(table.folder)
        schemas[table.folder] = _described(table.schema)
        part = _write(out / table.folder, table)
        written = Written(written.files + part.files, written.rows + part.rows, written.bytes + part.bytes)
    metadata = {"program": f"gss {__version__}", "partitions": "hive", "day": "UTC", "tables": schemas}
    (out / "schema.json").write_text(json.dumps(metadata, indent=1, ensure_ascii=False) + "\n", "utf-8")
    (out / "README.md").write_text(_readme(schemas), "utf-8")
    return written


def _tables(database: Database, dictionary: TelemetryDefinitions, start: datetime, end: datetime) -> Iterator[_Table]:
    packets = {packet.name: packet for packet in dictionary.telemetry}
    for name in store.packet_names(database):
        if not name.replace("_", "").isalnum():
            continue  # a packet with another name must not become a folder
        items = list(packets[name].fields) if name in packets else None
        schema = LEADING if items is None else pa.unify_schemas([LEADING, pa.schema([_field(i) for i in items])])
        # The ground's line counters are not in the device's dictionary.
        text_column = "values" if items is None else OTHER_VALUES
        schema = schema.append(pa.field(text_column, pa.string(), metadata={"json": "yes"}))
        blocks = ([_packet(row, items) for row in block] for block in store.telemetry(database, name, start, end))
        yield _Table(f"telemetry/packet={name}", schema, blocks)
    solved = pa.schema([f.with_metadata({"unit": _unit(f.name)}) if _unit(f.name) else f for f in SOLUTIONS])
    blocks = ([(r[0], as_row(r[2], r[3])) for r in block] for block in store.solutions(database, start, end))
    yield _Table("solutions", solved, blocks)
    blocks = ([s for r in block for s in _stars(r[0], r[3])] for block in store.solutions(database, start, end))
    yield _Table("stars", STARS, blocks)
    blocks = ([(r[0], _command(r[2])) for r in block] for block in store.commands(database, start, end))
    yield _Table("commands", COMMANDS, blocks)
    blocks = ([(r[0], _event(r[2])) for r in block] for block in store.events(database, start, end))
    yield _Table("events", EVENTS, blocks)


def _write(folder: Path, table: _Table) -> Written:
    """Write a file per day. Only one file is open at a time, because the rows are in order of time."""
    files = rows = size = 0
    day: date | None = None
    with ExitStack() as stack:
        writer: pq.ParquetWriter | None = None
        path, part = folder, folder
        for block in table.blocks:
            for of_day, group in groupby(block, key=lambda row: row[0].astimezone(UTC).date()):
                if of_day != day or writer is None:
                    if writer is not None:
                        size += _finish(writer, part, path)
                    day, path = of_day, folder / f"day={of_day}" / "part-0.parquet"
                    path.parent.mkdir(parents=True, exist_ok=True)
                    part, files = path.with_suffix(".part"), files + 1
                    writer = stack.enter_context(pq.ParquetWriter(part, table.schema, compression="zstd"))
                rows_of_group = [values for _, values in group]
                writer.write_table(pa.Table.from_pylist(rows_of_group, schema=table.schema))
                rows += len(rows_of_group)
        if writer is not None:
            size += _finish(writer, part, path)
    return Written(files, rows, size)


def _finish(writer: pq.ParquetWriter, part: Path, path: Path) -> int:
    writer.close()
    part.rename(path)
    return path.stat().st_size


# --- rows -------------------------------------------------------------------------------------------------------------


def _field(item: Item | Group) -> pa.Field:
    if isinstance(item, Group):
        return pa.field(item.name, pa.list_(pa.struct([(i.name, _type(i)) for i in item.items])))
    metadata = {"unit": item.unit, "title": item.title} if isinstance(item, TelemetryField) else {}
    return pa.field(item.name, _type(item), metadata=metadata)


def _type(item: Item) -> pa.DataType:
    return pa.type_for_alias(column_type(item))


def _packet(row: Any, items: list[Item | Group] | None) -> tuple[datetime, dict[str, object]]:
    received, row_id, contact_id, device_time_s, request_id, values = row
    columns = {"received": received, "id": row_id, "contact_id": contact_id, "device_time_s": device_time_s or None}
    values_by_name: dict[str, object] = {}
    if items is None:
        values_by_name["values"] = json_text(values)
    else:
        values_by_name = {item.name: _in_type(item, values.get(item.name)) for item in items}
        others = {n: value for n, value in values.items() if value is not None and values_by_name.get(n) is None}
        values_by_name[OTHER_VALUES] = json_text(others) if others else None
    return received, columns | {"request_id": request_id} | values_by_name


def _in_type(item: Item | Group, value: Any) -> Any:
    """Return a value that its column can hold; None for another value."""
    if not isinstance(item, Group):
        return typed(item, value)
    if not isinstance(value, list):
        return None
    rows = [{i.name: typed(i, row.get(i.name)) for i in item.items} for row in value]
    held = all(
        old.keys() <= new.keys() and all(new[n] is not None or old.get(n) is None for n in new)
        for new, old in zip(rows, value, strict=True)
    )
    return rows if held else None


def _stars(created: datetime, solution: Any) -> Iterator[tuple[datetime, dict[str, object]]]:
    common = {"created": created, "solution_id": solution.id, "frame_id": solution.frame_id, "chain": solution.chain}
    for star in solution.detail.get("stars", ()):
        yield created, common | {name: star.get(name) for name in STARS.names[4:]}


def _command(row: Any) -> dict[str, object]:
    record = {name: getattr(row, name) for name in COMMANDS.names if name not in ("arguments", "values", "stages")}
    stages = [{"stage": s.stage, "at": s.at, "detail": s.detail} for s in row.stages]
    return record | {"arguments": json_text(row.arguments), "values": json_text(row.values), "stages": stages}


def _event(row: Any) -> dict[str, object]:
    return {name: getattr(row, name) for name in EVENTS.names if name != "data"} | {"data": json_text(row.data)}


# --- metadata and README ----------------------------------------------------------------------------------------------


def _unit(name: str) -> str:
    return next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "")


def _described(schema: pa.Schema) -> list[dict[str, str]]:
    described = []
    for column in schema:
        metadata = {k.decode(): v.decode() for k, v in (column.metadata or {}).items()}
        described.append({"name": column.name, "type": str(column.type)} | metadata)
    return described


DUCKDB = (
    "SELECT day, max(supply_3v3_v)\n"
    "FROM read_parquet('telemetry/packet=housekeeping/**/*.parquet', hive_partitioning = true)\n"
    "GROUP BY day ORDER BY day;"
)
PYTHON = """import pyarrow.dataset as ds
table = ds.dataset("telemetry/packet=housekeeping", partitioning="hive").to_table()

import pandas as pd
frame = pd.read_parquet("solutions")"""


def _readme(tables: Iterable[str]) -> str:
    parts = [
        "# Export of a GSS store",
        "Parquet in hive-style folders, one file per table and UTC day. Columns, types and units: `schema.json`, and each column's "
        "metadata. Times are UTC. Telemetry is in engineering values; choices are text; lists are lists of records; JSON "
        "columns are text. `other_values` has the values of fields that had another type or no longer exist.",
        "\n".join(f"- `{name}/day=YYYY-MM-DD/part-0.parquet`" for name in tables),
        f"```sql\n{DUCKDB}\n```",
        f"```python\n{PYTHON}\n```",
    ]
    return "\n\n".join(parts) + "\n"

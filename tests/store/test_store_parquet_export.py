"""Export as partitioned Parquet tables, read with other libraries and compared with the store."""

from __future__ import annotations

import json
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest

from gss.cli import main
from gss.domain.errors import BadInput
from gss.instruments.dictionary.read_dictionary import load_dictionary, parse_dictionary
from gss.operations.upkeep.parquet_export import export_parquet
from gss.store import commands, events, frames, telemetry
from gss.store import exports as blocks
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate
from gss.store.models import Frame, Solution, TelemetryPacket

T0 = datetime(2026, 12, 1, 22, 0, tzinfo=UTC)
STAR = {"index": 0, "col_px": 12.5, "row_px": 7.25, "flux_dn": 900.0, "peak_dn": 90.0, "area_px": 4, "hip": 27989}
SPOT = {"items": [{"col_px": 1.5, "row_px": 2.5, "flux_dn": 9.0, "peak_dn": 7, "area_px": 4}], "frame_number": 3}


@pytest.fixture
def database_with_rows(database: Database, monkeypatch: pytest.MonkeyPatch) -> Database:
    """Database with rows of four hours across midnight UTC, and small blocks, so that a day has several."""
    monkeypatch.setattr(blocks, "BLOCK_ROWS", 7)
    monkeypatch.setattr(blocks, "SOLUTION_ROWS", 2)
    with database.unit_of_work() as session:
        for k in range(40):
            time, values = (
                T0 + timedelta(minutes=6 * k),
                {"supply_3v3_v": 3.3 + k / 3, "mode": "tracking", "latchups": k},
            )
            rows = [("housekeeping", values), ("ground_line", {"good": k})]
            rows += [("centroids", SPOT)] if k % 10 == 0 else []
            for name, packet_values in rows:
                row = TelemetryPacket(
                    packet=name, received=time, device_time_s=float(k), request_id=k, values=packet_values
                )
                telemetry.add_batch(session, [row])
            events.add(session, time, "link", "ok", f"line {k} – ü", {"k": k})
        for k in range(5):
            time = T0 + timedelta(hours=k)
            frame = frames.add(
                session,
                Frame(
                    source="import",
                    name="f",
                    taken=time,
                    received=time,
                    columns=4,
                    rows=2,
                    bits=8,
                    dtype="|u1",
                    sha256="0",
                ),
            )
            solution = Solution(
                frame_id=frame.id, origin="ground", chain="c", version="1", created=time, outcome="solved"
            )
            solution.quaternion, solution.detail = (
                [0.0, 0.0, 0.0, 1.0],
                {"stars": [STAR, STAR | {"index": 1, "hip": None}]},
            )
            frames.add_solution(session, solution)
            commands.add(
                session, time, contact_id=None, request_id=k, name="NOOP", arguments={"k": k}, user="u", source="form"
            )
    return database


def read(folder: Path, table: str) -> list[dict[str, object]]:
    """Return a table as pyarrow reads it, including the columns in folder names."""
    rows: list[dict[str, object]] = ds.dataset(folder / table, partitioning="hive").to_table().to_pylist()
    return rows


def test_exported_tables_equal_the_store(database_with_rows: Database, tmp_path: Path) -> None:
    """The export has every row once, in the folder of its day, with exactly its values, on every database."""
    summary = export_parquet(database_with_rows, load_dictionary(), tmp_path / "out")
    out = tmp_path / "out"
    rows = read(out, "telemetry/packet=housekeeping")
    assert [r["id"] for r in rows] == sorted(r["id"] for r in rows)
    assert [r["supply_3v3_v"] for r in rows] == [3.3 + k / 3 for k in range(40)]
    assert [r["received"] for r in rows] == [T0 + timedelta(minutes=6 * k) for k in range(40)]
    assert all(str(r["day"]) == f"{r['received']:%Y-%m-%d}" for r in rows)
    assert {r["mode"] for r in rows} == {"tracking"}
    spots = read(out, "telemetry/packet=centroids")
    assert [(r["items"], r["frame_number"]) for r in spots] == [(SPOT["items"], 3)] * 4
    ground_line = read(out, "telemetry/packet=ground_line")
    assert [json.loads(str(r["values"]))["good"] for r in ground_line] == list(range(40))
    assert [(r["text"], json.loads(str(r["data"]))) for r in read(out, "events")] == [
        (f"line {k} – ü", {"k": k}) for k in range(40)
    ]
    assert [(r["hip"], r["col_px"]) for r in read(out, "stars")] == [(27989, 12.5), (None, 12.5)] * 5
    assert [r["quaternion_w"] for r in read(out, "solutions")] == [1.0] * 5
    sent = read(out, "commands")
    assert [(r["name"], json.loads(str(r["arguments"]))["k"]) for r in sent] == [("NOOP", k) for k in range(5)]
    assert [[s["stage"] for s in r["stages"]] for r in sent] == [["queued"]] * 5
    assert summary.rows == 40 + 40 + 4 + 5 + 10 + 5 + 40
    assert summary.files == len(list(out.rglob("*.parquet"))) == 7 * 2
    assert not list(out.rglob("*.part"))


def test_unsigned_numbers_of_64_bits_are_exported_exactly(database: Database, tmp_path: Path) -> None:
    """Numbers above 2⁶³, and numbers that a float64 cannot hold, are exported without a change."""
    dictionary = parse_dictionary(
        "version: 1\ndevice_model: m\ncommands: []\nevents: []\nservices: []\ntelemetry:\n"
        "  - {name: p, code: 1, purpose: p, stale_after_s: 5, fields: [{name: n, type: u64}]}\n"
    )
    row = {"packet": "p", "received": T0, "device_time_s": 0.0, "request_id": 0, "contact_id": None}
    numbers = [2**53 + 1, 2**64 - 1]
    with database.unit_of_work() as session:
        telemetry.add_many(session, [row | {"values": {"n": n}} for n in numbers])
    export_parquet(database, dictionary, tmp_path / "out")
    assert [r["n"] for r in read(tmp_path / "out", "telemetry/packet=p")] == numbers


def test_units_are_in_the_columns_and_in_the_schema_file(database_with_rows: Database, tmp_path: Path) -> None:
    """Unit and title of each field are in the metadata of its column and in schema.json."""
    export_parquet(database_with_rows, load_dictionary(), tmp_path / "out")
    out = tmp_path / "out"
    (file, _) = sorted((out / "telemetry" / "packet=housekeeping").rglob("*.parquet"))
    metadata = pq.read_schema(file).field("supply_3v3_v").metadata
    assert metadata[b"unit"] == b"V"
    tables = json.loads((out / "schema.json").read_text())["tables"]
    (column,) = [c for c in tables["telemetry/packet=housekeeping"] if c["name"] == "supply_3v3_v"]
    assert column == {"name": "supply_3v3_v", "type": "double", "unit": "V", "title": metadata[b"title"].decode()}
    assert next(c for c in tables["solutions"] if c["name"] == "rms_px")["unit"] == "px"
    assert "day=YYYY-MM-DD" in (out / "README.md").read_text()


def test_duckdb_reads_the_exported_files(database_with_rows: Database, tmp_path: Path) -> None:
    """DuckDB, another library than the writer's, answers a query like that in the README."""
    duckdb = pytest.importorskip("duckdb")
    export_parquet(database_with_rows, load_dictionary(), tmp_path / "out")
    files = f"'{tmp_path}/out/telemetry/packet=housekeeping/**/*.parquet'"
    table = f"read_parquet({files}, hive_partitioning = true)"
    query = f"SELECT day, count(*), max(latchups) FROM {table} GROUP BY day ORDER BY day"  # noqa: S608
    assert duckdb.sql(query).fetchall() == [(date(2026, 12, 1), 20, 19), (date(2026, 12, 2), 20, 39)]


def test_days_are_rewritten_and_other_folders_rejected(database_with_rows: Database, tmp_path: Path) -> None:
    """A second export into the same folder adds the other day. A folder with other files and an inverted span are
    rejected."""
    out = tmp_path / "out"
    export_parquet(database_with_rows, load_dictionary(), out, date(2026, 12, 2), date(2026, 12, 2))
    assert {r["day"] for r in read(out, "events")} == {"2026-12-02"}
    export_parquet(database_with_rows, load_dictionary(), out)
    assert len(read(out, "events")) == 40
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years")
    with pytest.raises(BadInput, match="contains other files"):
        export_parquet(database_with_rows, load_dictionary(), tmp_path / "mine")
    with pytest.raises(BadInput, match="span"):
        export_parquet(database_with_rows, load_dictionary(), out, date(2026, 12, 2), date(2026, 12, 1))


def test_the_shell_exports_a_data_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``gss export parquet`` exports a data folder and reports files and rows."""
    url = f"sqlite:///{tmp_path / 'gss.db'}"
    migrate(url)
    database = Database(open_engine(url))
    with database.unit_of_work() as session:
        events.add(session, T0, "link", "ok", "line open", {})
    database.close()
    assert main(["export", "parquet", "--out", str(tmp_path / "out"), "--data", str(tmp_path)]) == 0
    assert "1 files, 1 rows" in capsys.readouterr().out
    assert [r["text"] for r in read(tmp_path / "out", "events")] == ["line open"]

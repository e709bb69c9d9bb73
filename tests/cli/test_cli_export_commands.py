"""``gss export commands``: command history on the terminal and in files."""

from __future__ import annotations

import csv
import io
import json
from datetime import UTC, datetime, timedelta

import pytest

from gss.cli import main
from gss.settings import Settings
from gss.store import commands
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate

T0 = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)


@pytest.fixture
def folder(tmp_path):
    """Data folder with three commands, one minute apart."""
    url = Settings(data=tmp_path).database_url
    migrate(url)
    database = Database(open_engine(url))
    with database.unit_of_work() as session:
        for k, (name, result, user) in enumerate(
            (("RESET", "completed", "ann"), ("SET_EXPOSURE", "failed", "bob"), ("RESET", "unknown", "bob"))
        ):
            at, arguments = T0 + timedelta(minutes=k), {"exposure_ms": 5} if name == "SET_EXPOSURE" else {}
            row = commands.add(
                session, at, contact_id=None, request_id=k + 1, name=name, arguments=arguments, user=user, source="form"
            )
            row.result = result
            row.detail = 'said "no", twice\n' if result == "failed" else ""
    database.close()
    return tmp_path


def export(capsys, folder, *options: str) -> str:
    assert main(["export", "commands", "--data", str(folder), *options]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "ids"),
    [
        ((), [1, 2, 3]),
        (("--name", "RESET"), [1, 3]),
        (("--result", "failed", "--result", "unknown"), [2, 3]),
        (("--user", "bob", "--name", "RESET"), [3]),
        (("--from", "2026-12-01T18:01:00Z"), [2, 3]),
        (("--to", "2026-12-01T18:01:00"), [1]),
        (("--text", "twice"), [2]),
        (("--contact", "9"), []),
    ],
)
def test_both_formats_contain_the_matching_commands(capsys, folder, options, ids):
    """CSV and JSON contain the commands that meet all conditions. Quotes and line breaks are preserved."""
    table = list(csv.DictReader(io.StringIO(export(capsys, folder, *options))))
    rows = json.loads(export(capsys, folder, "--format", "json", *options))
    assert [int(line["id"]) for line in table] == [row["id"] for row in rows] == ids
    assert [line["detail"] for line in table] == [row["detail"] for row in rows]


def test_a_file_is_written_as_the_terminal_shows_it(capsys, folder):
    """The file written with --out has the same content as standard output."""
    shown = export(capsys, folder)
    assert export(capsys, folder, "--out", str(folder / "c.csv")) == ""
    with (folder / "c.csv").open(newline="") as file:
        assert list(csv.reader(file)) == list(csv.reader(io.StringIO(shown)))


@pytest.mark.parametrize(
    "options", [("--from", "yesterday"), ("--from", "2026-12-02T00:00:00Z", "--to", "2026-12-01T00:00:00Z")]
)
def test_invalid_spans_are_rejected(capsys, folder, options):
    """An invalid or empty span is rejected with a message."""
    assert main(["export", "commands", "--data", str(folder), *options]) != 0
    assert "not a valid time" in (words := capsys.readouterr().err) or "span is empty" in words


def test_a_rejected_export_leaves_the_file_as_it_was(capsys, folder, tmp_path):
    """The time span is empty. The file of the last export is kept."""
    out = tmp_path / "commands.csv"
    export(capsys, folder, "--out", str(out))
    before = out.read_bytes()
    span = ("--from", "2026-12-02", "--to", "2026-12-01")
    assert main(["export", "commands", "--data", str(folder), *span, "--out", str(out)]) == 2
    assert out.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".part"] == []

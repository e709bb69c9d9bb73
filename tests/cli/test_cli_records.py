"""``gss export telemetry``, ``gss export contact-report``, ``gss check record`` and ``gss replay``."""

from __future__ import annotations

import csv
import io
import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from gss.cli import main
from gss.device.protocol.codec import encode
from gss.device.protocol.packet import PacketType
from gss.device.protocol.sender import LineSender
from gss.domain.errors import BadInput
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.operations.line.line_capture import RawCapture
from gss.operations.line.raw_capture import RECEIVED, SENT
from gss.settings import Settings
from gss.store import devices, telemetry
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate
from gss.store.models import TelemetryPacket

T0 = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Data folder with contact 1: ten seconds of housekeeping, of which one packet is missing without a cause."""
    url = Settings(data=tmp_path).database_url
    migrate(url)
    database = Database(open_engine(url))
    rows = [
        TelemetryPacket(
            contact_id=1,
            packet="housekeeping",
            received=T0 + timedelta(seconds=k),
            device_time_s=50.0 + k,
            request_id=0,
            values={"mode": "standby", "latchups": k, "uptime_s": k},
        )
        for k in range(10)
        if k != 6
    ]
    with database.unit_of_work() as session:
        contact = devices.open_contact(session, "memory://", T0, "")
        devices.update_contact(session, contact.id, ended=T0 + timedelta(seconds=10))
        telemetry.add_batch(session, rows)
    database.close()
    return tmp_path


def test_telemetry_of_a_contact_and_of_a_span(data, capsys, tmp_path):
    """Telemetry is exported by contact or by times into a file. Invalid selections give exit code 2."""
    arguments = ["export", "telemetry", "--data", str(data), "--fields", "mode, latchups"]
    out = tmp_path / "t.csv"
    assert main([*arguments, "--contact", "1", "--out", str(out)]) == 0
    rows = list(csv.DictReader(io.StringIO(out.read_text(), newline="")))
    assert [r["latchups"] for r in rows] == list("012345789")
    span = ["--from", "2026-12-01T18:00:02", "--to", "2026-12-01T18:00:04Z", "--out", str(out)]
    assert main([*arguments, *span]) == 0
    assert len(out.read_text().splitlines()) == 4
    for wrong in ([], ["--from", "yesterday", "--to", "today"], ["--contact", "9"], ["--data", str(data / "no")]):
        assert main([*arguments, *wrong]) == 2
    assert "gss:" in capsys.readouterr().err


def test_a_failed_export_keeps_the_earlier_file(data, tmp_path, monkeypatch):
    """If an export fails after its first piece, an existing file is unchanged and nothing else is left in the folder."""

    def failing(*_, **__):
        yield b"first piece"
        raise BadInput("the second piece cannot be read")

    monkeypatch.setattr("gss.operations.telemetry.telemetry_export.export", failing)
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "t.csv").write_text("earlier")
    arguments = ["export", "telemetry", "--data", str(data), "--fields", "mode", "--contact", "1"]
    assert main([*arguments, "--out", str(folder / "t.csv")]) == 2
    assert [(file.name, file.read_text()) for file in folder.iterdir()] == [("t.csv", "earlier")]


def test_the_record_check_reports_the_gap_and_its_exit_code(data, capsys):
    """A missing packet without a cause gives exit code 1, as text and as JSON. An unknown contact gives exit code 2."""
    assert main(["check", "record", "--data", str(data), "--json"]) == 1
    facts = json.loads(capsys.readouterr().out)
    assert (facts["expected"], facts["held"], facts["unexplained"]) == (10, 9, 1)
    (gap,) = facts["contacts"][0]["gaps"]
    assert (gap["start"], gap["missing"], gap["explained"]) == ("2026-12-01T18:00:05.000Z", 1, False)
    assert main(["check", "record", "--data", str(data), "--all"]) == 1
    assert "9 of 10 packets (90.000 %), 1 gaps, 1 without a cause" in capsys.readouterr().out
    assert main(["check", "record", "--data", str(data), "--contact", "7"]) == 2


def test_the_pass_report_is_a_page_or_figures(data, capsys, tmp_path):
    """The report of a contact is written as HTML or PDF, or printed as JSON."""
    out = tmp_path / "report.html"
    arguments = ["export", "contact-report", "--data", str(data), "--contact", "1"]
    assert main([*arguments, "--out", str(out)]) == 0
    assert "9 of 10 housekeeping packets" in out.read_text(encoding="utf-8")
    assert main([*arguments, "--format", "pdf", "--out", str(out)]) == 0
    assert out.read_bytes().startswith(b"%PDF")
    assert main([*arguments, "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out)["record"]["unexplained"] == 1


def test_a_capture_is_printed_decoded(capsys, tmp_path):
    """The capture gives a command and an event, and noise is counted. A missing file is exit code 2, an empty one 3."""
    dictionary = load_dictionary()
    device = LineSender(to_device=False, prefix=dictionary.prefix)
    ground = LineSender(to_device=True, prefix=dictionary.prefix)
    payload = encode(dictionary.service("EVENT").fields, {"text": "rail fpga"})
    event = device.packet(PacketType.EVENT, dictionary.event_named("LATCHUP").code, 0, payload, 5.0)
    command = ground.packet(PacketType.COMMAND, dictionary.command("GET_STATUS").code, 7, b"")
    capture = RawCapture(tmp_path / "captures", 1)
    capture.write(T0.timestamp(), SENT, command)
    capture.write(T0.timestamp() + 1, RECEIVED, event[:5])
    capture.write(T0.timestamp() + 2, RECEIVED, event[5:] + b"\x05noise\0")
    capture.close()
    (file,) = (tmp_path / "captures").iterdir()
    assert main(["replay", str(file), "--json"]) == 0
    captured = capsys.readouterr()
    messages = [json.loads(line) for line in captured.out.splitlines()]
    assert [(s["kind"], s["name"], s["at"]) for s in messages] == [
        ("command", "GET_STATUS", "2026-12-01T18:00:00.000Z"),
        ("event", "LATCHUP", "2026-12-01T18:00:02.000Z"),
    ]
    assert (messages[0]["request_id"], messages[1]["text"], messages[1]["severity"]) == (7, "rail fpga", "critical")
    assert "1 good packets, 1 damaged" in captured.err
    assert main(["replay", str(file)]) == 0
    assert "LATCHUP" in capsys.readouterr().out
    assert main(["replay", str(tmp_path / "no.raw")]) == 2
    assert main(["replay", str(file), "--speed", "0.01"]) == 2
    empty = tmp_path / "contact-000002-000.raw"
    empty.touch()
    assert main(["replay", str(empty)]) == 3
    received_bytes = tmp_path / "received.bin"
    received_bytes.write_bytes(b"\0" + event)
    capsys.readouterr()
    assert main(["replay", str(received_bytes)]) == 2
    assert "is not a capture" in capsys.readouterr().err
    assert main(["replay", str(received_bytes), "--received", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["name"] == "LATCHUP"

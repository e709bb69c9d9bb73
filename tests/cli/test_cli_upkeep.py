"""Backup, restore, check of the store and retention on the command line."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
from pathlib import Path

import pytest

from gss.cli import main
from gss.store import frames
from gss.store.blobs import BlobStore
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate
from gss.store.models import Frame


@pytest.fixture
def folder(tmp_path):
    """Data folder with one frame."""
    from datetime import UTC, datetime

    folder, at = tmp_path / "data", datetime(2026, 1, 2, tzinfo=UTC)
    key = BlobStore(str(folder / "blobs")).put(b"12345678")
    url = f"sqlite:///{folder / 'gss.db'}"
    migrate(url)
    database = Database(open_engine(url))
    row = {"source": "device", "name": "f", "taken": at, "received": at, "columns": 4, "rows": 2, "bits": 8}
    with database.unit_of_work() as session:
        frames.add(session, Frame(dtype="|u1", sha256=key, complete=True, rows_held=[[0, 1]], parameters={}, **row))
    database.close()
    return folder


def test_a_backup_is_restored_and_checked_from_the_shell(folder, tmp_path, capsys):
    """Backup, restore and check work as docs/upkeep.md describes.

    A backup with --keep 1 removes earlier backups, but not while the clock, which is months after the last row, is
    unconfirmed. A restore into a folder that is not empty is rejected. The check reports a missing file.
    """
    backup = ["backup", "--data", str(folder), "--to", str(tmp_path / "safe"), "--keep", "1", "--json"]
    for _ in range(2):
        assert main(backup) == 0
    output = capsys.readouterr()
    assert json.loads(output.out.splitlines()[-1])["removed"] == []
    assert "Old backups were not removed: the server's clock is" in output.err
    assert main(["retention", "--data", str(folder), "--confirm-clock"]) == 0
    capsys.readouterr()
    assert main(backup) == 0
    backup_result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (backup_result["files"], len(backup_result["removed"])) == (1, 2)
    assert main(["restore", backup_result["folder"], "--into", str(tmp_path / "new")]) == 0
    assert main(["restore", backup_result["folder"], "--into", str(tmp_path / "new")]) == 2
    assert "target folder is not empty" in capsys.readouterr().err
    assert main(["check", "store", "--data", str(tmp_path / "new"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["whole"], report["rows"]["frames"]) == (True, 1)
    next(p for p in (tmp_path / "new" / "blobs").rglob("*") if p.is_file()).unlink()
    assert main(["check", "store", "--data", str(tmp_path / "new")]) == 1
    out = capsys.readouterr().out
    assert all(words in out for words in ("ERROR missing files", "frame 1", "NOT intact"))


def test_only_the_owner_can_read_a_backup_and_a_restored_folder(folder, tmp_path, capsys):
    """No other user can access the files and folders that backup and restore create, nor earlier backups
    that were open to all. The umask is restored."""
    umask, earlier = os.umask(0o022), tmp_path / "safe" / "2026-01-01T000000Z"
    try:
        earlier.mkdir(parents=True)
        (tmp_path / "safe" / "blobs" / "00").mkdir(parents=True)
        assert main(["backup", "--data", str(folder), "--to", str(tmp_path / "safe"), "--json"]) == 0
        made = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert main(["restore", made["folder"], "--into", str(tmp_path / "new")]) == 0
        assert os.umask(0o022) == 0o022
    finally:
        os.umask(umask)
    (tmp_path / "safe" / "blobs" / "00").rmdir()
    created = [*(tmp_path / "safe").rglob("*"), tmp_path / "new", *(tmp_path / "new").rglob("*")]
    assert {tmp_path / "new" / "gss.db", tmp_path / "safe" / made["name"] / "gss.db", earlier} <= set(created)
    assert [str(path) for path in created if path.stat().st_mode & 0o077] == []


@contextlib.contextmanager
def without_permissions():
    """Run the block without the permissions of root, which may write everywhere."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


def test_a_read_only_copy_is_checked(folder, capsys):
    """A user without write permission can check a copy. A copy with a write-ahead log is rejected with a message."""
    assert main(["check", "store", "--data", str(folder)]) == 0
    with tempfile.TemporaryDirectory() as folder_name:
        copy = Path(folder_name) / "copy"
        shutil.copytree(folder, copy)
        log = copy / "gss.db-wal"
        for path in (Path(folder_name), copy, *copy.rglob("*")):
            path.chmod(0o555 if path.is_dir() else 0o444)
        with without_permissions():
            assert main(["check", "store", "--data", str(copy)]) == 0
        copy.chmod(0o755)
        log.write_bytes(b"x")
        copy.chmod(0o555)
        with without_permissions():
            assert main(["check", "store", "--data", str(copy)]) == 2
        assert "write-ahead log" in capsys.readouterr().err
        for path in (Path(folder_name), copy, *copy.rglob("*")):
            path.chmod(0o755)


def test_retention_reports_its_effect_and_rejects_a_wrong_folder(folder, tmp_path, capsys):
    """The command prints policy and forecast. A run is rejected while the clock is in doubt, and works after
    confirmation. Folders that do not exist are rejected.
    """
    assert main(["retention", "--data", str(folder), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["policy"]["frames_days"], facts["forecast"]["frames_bytes"]) == (0, 8)
    assert "days ahead" in facts["clock"]["doubt"]
    assert main(["retention", "--data", str(folder), "--run"]) == 2
    assert "--confirm-clock" in capsys.readouterr().err
    assert main(["retention", "--data", str(folder), "--confirm-clock"]) == 0
    assert main(["retention", "--data", str(folder), "--run"]) == 0
    out = capsys.readouterr().out
    assert all(
        words in out
        for words in ("frames with removed pixels", "pixels are deleted at the age of", "8 B", "kept indefinitely")
    )
    assert "_" not in out.replace("GSS_CAPTURE_KEEP_MB", "")
    assert main(["check", "store", "--data", str(tmp_path / "nowhere")]) == 2
    assert main(["restore", str(tmp_path / "nowhere"), "--into", str(tmp_path / "x")]) == 2


def test_invalid_input_gives_one_line_without_a_traceback(folder, tmp_path, capsys, monkeypatch):
    """A damaged backup, a file in place of a folder and an invalid setting give one line without a traceback."""
    assert main(["backup", "--data", str(folder), "--to", str(tmp_path / "safe"), "--json"]) == 0
    backup = json.loads(capsys.readouterr().out)
    (tmp_path / "safe" / backup["name"] / "manifest.sha256").write_text("")
    assert main(["restore", backup["folder"], "--into", str(tmp_path / "new")]) == 2
    (tmp_path / "file").write_text("x")
    assert main(["audit", "export", "--data", str(folder), "--out", str(tmp_path)]) == 1
    assert main(["backup", "--data", str(tmp_path / "file")]) != 0
    monkeypatch.setenv("GSS_PORT", "many")
    assert main(["check", "store", "--data", str(folder)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 4
    assert all(line.startswith("gss: ") for line in lines)
    assert "GSS_PORT" in lines[3] or "port" in lines[3]


def test_a_failed_removal_is_reported_with_an_exit_code(folder, capsys, monkeypatch):
    """A removal that cannot delete files ends with exit code 1 and its reason, also as JSON."""

    def fails(*_):
        raise OSError(5, "Input/output error")

    assert main(["retention", "--data", str(folder), "--confirm-clock"]) == 0
    monkeypatch.setattr("gss.operations.upkeep.retention.RetentionService._remove", fails)
    for options in ([], ["--json"]):
        capsys.readouterr()
        assert main(["retention", "--data", str(folder), "--run", *options]) == 1
        assert "the removal is failed: Internal error" in capsys.readouterr().err

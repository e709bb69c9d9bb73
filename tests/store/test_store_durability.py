"""Acknowledged writes are flushed before they return, so that a power failure loses none."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from sqlalchemy import text

from gss.operations.clock import utc_now
from gss.operations.line.line_capture import CaptureSync, LineCapture
from gss.operations.line.raw_capture import RECEIVED, Retention
from gss.store import engine
from gss.store.blobs import BlobStore
from gss.store.engine import Database, open_engine
from gss.store.upkeep import database_bytes

FULL, NORMAL = 2, 1


def synchronous(database: Database, **options: bool) -> int:
    """Return SQLite's setting ``synchronous`` within a transaction."""
    with database.unit_of_work(**options) as session:
        return int(session.connection().exec_driver_sql("PRAGMA synchronous").scalar_one())


@pytest.fixture
def flushed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Paths that were flushed to the disk, in order. The flush is executed."""
    paths: list[str] = []
    original_fsync = os.fsync

    def recording_fsync(handle: int) -> None:
        paths.append(os.readlink(f"/proc/self/fd/{handle}"))
        original_fsync(handle)

    monkeypatch.setattr(os, "fsync", recording_fsync)
    return paths


def test_commits_reach_the_disk_except_telemetry(tmp_path: Path) -> None:
    """Each commit of SQLite is flushed, except those with ``durable=False``, which do not change later commits."""
    database = Database(open_engine(f"sqlite:///{tmp_path / 'gss.db'}"))
    assert synchronous(database) == FULL
    assert synchronous(database, durable=False) == NORMAL
    assert synchronous(database) == FULL
    database.close()


def test_a_stored_blob_is_flushed_before_its_name_exists(tmp_path: Path, flushed: list[str]) -> None:
    """The bytes of a blob are flushed first, then the folders with its name."""
    root = tmp_path / "blobs"
    key = BlobStore(str(root)).put(b"pixels")
    assert flushed[0].startswith(f"{root}/{key[:2]}/{key[2:]}.")
    assert flushed[1:] == [f"{root}/{key[:2]}", str(root)]


def test_captures_are_flushed_once_a_second(tmp_path: Path, flushed: list[str]) -> None:
    """Once per second, all capture files written since the last time are flushed, including closed ones. Without new
    bytes nothing is flushed.
    """
    capture = LineCapture(tmp_path, Retention(file_bytes=100), utc_now, lambda text: None)
    now_s = [0.0]
    sync = CaptureSync(capture, lambda: now_s[0])
    capture.begin(1)
    for _ in range(3):
        capture.write(RECEIVED, bytes(90))
    sync()
    assert flushed == []
    now_s[0] = 1.0
    sync()
    assert sorted(flushed) == [str(tmp_path), *(str(p) for p in sorted(tmp_path.glob("*.raw")))]
    flushed.clear()
    now_s[0] = 2.0
    sync()
    assert flushed == []
    capture.end()


def test_a_failed_flush_of_a_capture_is_repeated(
    tmp_path: Path, flushed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the disk fails, the next flush includes all files of the failed flush, also if no further bytes were written."""
    capture = LineCapture(tmp_path, Retention(file_bytes=100), utc_now, lambda text: None)
    capture.begin(1)
    for _ in range(3):
        capture.write(RECEIVED, bytes(90))
    capture.end()

    def failing(handle: int) -> None:
        raise OSError("the disk fails")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", failing)
        with pytest.raises(OSError, match="the disk fails"):
            capture.sync()
    capture.sync()
    assert sorted(flushed) == [str(tmp_path), *(str(p) for p in sorted(tmp_path.glob("*.raw")))]


def test_a_large_write_ahead_log_is_truncated_after_a_long_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A long read keeps the write-ahead log from being merged. The size of the database includes the log, no row is lost,
    and writes after the read truncate the log."""
    monkeypatch.setattr(engine, "MAX_WAL_BYTES", 100_000)
    path = tmp_path / "gss.db"
    database = Database(open_engine(f"sqlite:///{path}"))
    with database.unit_of_work() as session:
        session.execute(text("CREATE TABLE rows (content BLOB)"))
    with database.engine.connect() as reader:
        reader.exec_driver_sql("BEGIN")  # Python's driver begins no transaction for a SELECT
        assert reader.scalar(text("SELECT count(*) FROM rows")) == 0
        for _ in range(200):
            with database.unit_of_work() as session:
                session.execute(text("INSERT INTO rows VALUES (randomblob(20000))"))
        log = path.with_name("gss.db-wal")
        assert log.stat().st_size > 4_000_000
        with database.unit_of_work() as session:
            assert database_bytes(session) > 4_000_000
    for _ in range(3):
        with database.unit_of_work() as session:
            session.execute(text("INSERT INTO rows VALUES (randomblob(20000))"))
    assert log.stat().st_size <= 200_000
    with database.unit_of_work() as session:
        assert session.scalar(text("SELECT count(*) FROM rows")) == 203
    database.close()

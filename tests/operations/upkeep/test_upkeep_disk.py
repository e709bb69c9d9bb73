"""A full disk, on a file system of two megabytes, and a damaged database page.

Nothing is partly written, every loss is counted and reported, and operation continues when there is room. A damaged
page stops the server with a message.
"""

from __future__ import annotations

import contextlib
import os
import resource
import sqlite3
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gss.device.session_events import Telemetry
from gss.domain.errors import CorruptData, StoreDown
from gss.domain.limits import State
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.events import EventBus
from gss.operations.jobs import JobKind, JobRequest, JobService
from gss.operations.line.capture_files import capture_files
from gss.operations.line.dispatcher import Dispatcher, LineEventQueue
from gss.operations.line.line_capture import RawCapture
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.line.raw_capture import RECEIVED, Retention, read_captures
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.upkeep.disk import DiskGuard, DiskWatch
from gss.operations.upkeep.page_check import PageCheck
from gss.store import engine
from gss.store.blobs import BlobStore
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate

DICTIONARY = load_dictionary()
SIZE = 2 << 20


class SmallDisk:
    """Folder of limited size: a tmpfs if this process may mount one, otherwise with a limit on the size of each file."""

    def __init__(self, folder: Path, mounted: bool) -> None:
        self.folder, self._mounted = folder, mounted

    @contextmanager
    def full(self, left: int = 0) -> Iterator[None]:
        """Within this context at most ``left`` more bytes can be written."""
        if not self._mounted:
            largest = max((p.stat().st_size for p in self.folder.rglob("*") if p.is_file()), default=0)
            soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest + left, hard))
            try:
                yield
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
            return
        ballast, block = self.folder / "ballast", os.sysconf("SC_PAGE_SIZE")
        with ballast.open("wb", buffering=0) as file:
            for size in (1 << 16, block):
                with contextlib.suppress(OSError):  # full, as intended
                    while free_bytes(self.folder) > left:
                        file.write(bytes(size))
        try:
            yield
        finally:
            ballast.unlink()


def free_bytes(folder: Path) -> int:
    status = os.statvfs(folder)
    return status.f_bavail * status.f_frsize


@pytest.fixture
def small_disk(tmp_path) -> Iterator[SmallDisk]:
    folder = tmp_path / "small"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder)]
    mounted = os.geteuid() == 0 and subprocess.run(command, capture_output=True, check=False).returncode == 0
    yield SmallDisk(folder, mounted)
    if mounted:
        subprocess.run(["umount", "-l", str(folder)], check=True, capture_output=True)


def test_a_capture_on_a_full_disk_has_complete_records_and_continues(small_disk):
    """A record that does not fit leaves no partial record, and the next one that fits is written."""
    capture = RawCapture(small_disk.folder, 1, Retention(1 << 20, 1 << 20))
    capture.write(1.0, RECEIVED, b"before" * 10)
    with small_disk.full():
        for _ in range(3):
            with pytest.raises(OSError, match=r"space|large"):
                capture.write(3.0, RECEIVED, bytes(20_000))
    capture.write(4.0, RECEIVED, b"after")
    capture.close()
    torn: list[int] = []
    records = list(read_captures(capture_files(small_disk.folder), lambda _, n: torn.append(n)))
    assert (records[0][2], records[-1][2], torn) == (b"before" * 10, b"after", [])


def test_a_contact_survives_a_full_disk_and_the_loss_is_reported(small_disk, sensor_in_memory, database, bus, clock):
    """On a full disk the link continues without its capture. Missing bytes are counted, reported and raise an alarm."""
    sensor = sensor_in_memory()
    events = LineEventQueue(clock, sensor.monotonic_s)
    link = LinkService(
        DICTIONARY,
        default_roles(DICTIONARY),
        database,
        bus,
        small_disk.folder,
        clock,
        sensor.monotonic_s,
        events,
    )
    telemetry = TelemetryService(
        DICTIONARY, database, bus, clock, lambda: None, lambda: True, default_roles(DICTIONARY).quantities.status
    )
    alarms = AlarmService(DICTIONARY, telemetry, link, database, bus, clock)
    watch = DiskWatch(DiskGuard(small_disk.folder, 0, 0), alarms, link, telemetry)
    dispatcher = Dispatcher(events, bus, sensor.monotonic_s, [link.handle, telemetry.handle])
    dispatcher.start()
    link.start()
    link.open_later(sensor.url)

    def until(done, what):
        limit_s = time.monotonic() + 30
        while not done():
            assert time.monotonic() < limit_s, what
            time.sleep(0.005)

    until(lambda: link.hello and telemetry.latest_packet("housekeeping"), "the sensor")
    contact = link.contact_id
    with small_disk.full():
        until(lambda: link.capture.lost_bytes > 2000, "bytes that did not fit")
        watch.tick()
        assert [(v.title, v.level) for v in alarms.opened()] == [("Raw capture", State.CRITICAL)]
        before = telemetry.latest_packet("housekeeping").device_time_s
        until(lambda: telemetry.latest_packet("housekeeping").device_time_s > before + 2, "the link to continue")
    until(lambda: not link.capture.fails, "the capture to continue")
    watch.tick()
    assert alarms.opened()[0].row.state == "cleared"
    assert link.contact_id == contact
    link.stop()
    dispatcher.stop()
    texts = [event.text for event in bus.after(0, 500)]
    assert len([t for t in texts if "data from now on is missing" in t]) == 1
    assert any(f"{link.capture.lost_bytes} bytes are missing from it" in t for t in texts)
    torn: list[int] = []
    assert len(list(read_captures(capture_files(small_disk.folder), lambda _, n: torn.append(n)))) > 3
    assert torn == []


def housekeeping(k: int) -> tuple[Telemetry]:
    fields = {"supply_3v3_v": 3.3, "mode": "standby", "cycle_running": False, "latchups": k}
    return (Telemetry("housekeeping", float(k), 0, fields, fields),)


def test_a_database_on_a_full_disk_loses_no_row_and_values_continue(small_disk, clock, tmp_path):
    """On a full disk telemetry is displayed, packets that are not stored are counted, and the database file is intact."""
    url = f"sqlite:///{small_disk.folder / 'gss.db'}"
    # The schema is created before the disk is full.
    migrate(url)
    database = Database(open_engine(url))
    bus = EventBus(database, clock)
    telemetry = TelemetryService(
        DICTIONARY, database, bus, clock, lambda: None, lambda: True, default_roles(DICTIONARY).quantities.status
    )
    telemetry.handle(LineBatch(housekeeping(1), clock(), 0.0))
    with small_disk.full():
        for k in range(2, 2000):
            telemetry.handle(LineBatch(housekeeping(k), clock(), 10.0 * k))
            if telemetry.unstored > 20:
                break
        with pytest.raises(StoreDown, match="cannot be used"):
            bus.record("x", "ok", "y" * 200_000)
        assert telemetry.latest_packet("housekeeping").values["latchups"] == k
        assert telemetry.store_fails
    telemetry.handle(LineBatch(housekeeping(k + 1), clock(), 10.0 * k + 10))
    assert telemetry.store_fails == ""
    assert any(f"{telemetry.unstored} earlier packets" in event.text for event in bus.after(0, 100))
    with database.engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA integrity_check").scalar() == "ok"
        stored = connection.exec_driver_sql("SELECT count(*) FROM telemetry_packets").scalar()
    assert stored == k + 1 - telemetry.unstored
    database.close()


def test_bytes_on_a_full_disk_are_rejected_and_leave_no_partial_file(small_disk):
    """A blob that does not fit is rejected and leaves no partial file. Others are stored."""
    blobs = BlobStore(str(small_disk.folder / "blobs"))
    stored_key = blobs.put(b"kept" * 1000)
    with small_disk.full(), pytest.raises(StoreDown, match="read or written"):
        blobs.put(bytes(range(256)) * 2000)
    assert blobs.get(stored_key) == b"kept" * 1000
    assert list(blobs.keys()) == [stored_key]


def test_large_jobs_stop_before_the_disk_is_full_and_retention_does_not(database, bus, clock, tmp_path):
    """Jobs and imports are rejected while there is still room for rows. Retention can always run."""
    room = [10_000]
    guard = DiskGuard(tmp_path, 5000, 1000, lambda _: (room[0], 20_000))
    jobs = JobService(database, bus, clock, guard.check)
    for kind in ("retention", "catalogue"):
        jobs.register(JobKind(kind, JobRequest, lambda request, run: {}))
    assert (guard.look().level, guard.has_room_for_rows()) == (State.OK, True)
    room[0] = 4000
    assert guard.look().level is State.WARNING
    guard.check("an import")
    with pytest.raises(StoreDown, match="no room for an import"):
        guard.check("an import", needed_bytes=3500)
    room[0] = 900
    assert (guard.look().level, guard.has_room_for_rows()) == (State.CRITICAL, True)
    with pytest.raises(StoreDown, match="nearly full"):
        jobs.begin("catalogue", "t", JobRequest())
    assert jobs.begin("retention", "t", JobRequest()).state == "queued"
    room[0] = 200
    assert not guard.has_room_for_rows()
    jobs.stop()


def damage(path: Path, table: str) -> None:
    """Write noise over a page in the middle of a table."""
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        size = connection.execute("PRAGMA page_size").fetchone()[0]
        root = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)).fetchone()[0]
    connection.close()
    with path.open("r+b") as file:
        file.seek((root - 1) * size)
        file.write(b"\xa5" * size)


def test_a_damaged_page_prevents_the_start_and_the_message_states_what_to_do(database, bus, tmp_path, capsys):
    """A server with a damaged database does not start. The message names the check, the restore and the raw captures."""
    from gss.cli import main

    for k in range(300):
        bus.record("x", "ok", f"line {k} " + "." * 200)
    database.close()
    damage(tmp_path / "gss.db", "events")
    with pytest.raises(CorruptData, match="damaged") as caught:
        migrate(f"sqlite:///{tmp_path / 'gss.db'}")
    assert all(words in caught.value.hint for words in ("gss check store", "gss restore", "raw captures"))
    assert main(["serve", "--data", str(tmp_path), "--port", "0"]) == 1
    assert "gss restore" in capsys.readouterr().err
    assert main(["check", "store", "--data", str(tmp_path)]) == 1
    assert "ERROR database" in capsys.readouterr().out


def test_a_page_damaged_while_the_server_runs_is_reported(database, bus, tmp_path):
    """The operation that reads a damaged page fails with a message, and the damage is reported from then on."""
    for k in range(300):
        bus.record("x", "ok", f"line {k} " + "." * 200)
    database.close()
    damage(tmp_path / "gss.db", "events")
    with pytest.raises(CorruptData, match="damaged"):
        bus.after(0, 1000)
    assert "malformed" in database.damage


def test_pages_of_a_large_file_are_checked_in_the_background(database, bus, tmp_path, monkeypatch):
    """A file too large for the check at the start is checked in the background. Damage is reported and recorded."""
    monkeypatch.setattr(engine, "QUICK_CHECK_BYTES", 1 << 30)
    small = PageCheck(database, bus)
    small.start()
    assert small.state == ""
    monkeypatch.setattr(engine, "QUICK_CHECK_BYTES", 0)
    for k in range(300):
        bus.record("x", "ok", f"line {k} " + "." * 200)
    large = PageCheck(database, bus)
    large.start()
    large.wait()
    assert (large.state, database.damage) == ("its pages were checked after the start", "")
    database.close()
    damage(tmp_path / "gss.db", "telemetry_packets")
    migrate(f"sqlite:///{tmp_path / 'gss.db'}")
    check = PageCheck(database, bus)
    check.start()
    check.wait()
    assert database.damage
    assert "The database is damaged" in bus.after(0, 1000)[-1].text

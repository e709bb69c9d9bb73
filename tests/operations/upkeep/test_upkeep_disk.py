"""A disk that fills up, on a file system of two megabytes: nothing is half written, every loss is counted and told, and when
there is room again everything goes on. A damaged page stops the server with words."""

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

from gss.device.dictionary_file import load_dictionary
from gss.device.session_events import Telemetry
from gss.domain.errors import CorruptData, StoreDown
from gss.domain.limits import State
from gss.operations.events import EventBus
from gss.operations.jobs import JobService
from gss.operations.line.dispatcher import Dispatcher
from gss.operations.line.line_events import LineBatch, LineEventQueue
from gss.operations.line.link import LinkService
from gss.operations.line.raw_capture import RECEIVED, RawCapture, Retention, capture_files, read_captures
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.upkeep.disk import DiskGuard, DiskWatch
from gss.operations.upkeep.page_check import PageCheck
from gss.store import engine
from gss.store.blobs import BlobStore
from gss.store.engine import Database, migrate, open_engine

DICTIONARY = load_dictionary()
SIZE = 2 << 20


class SmallDisk:
    """A folder that takes only so much: a tmpfs where this process may mount one; else no file may grow beyond its limit."""

    def __init__(self, folder: Path, mounted: bool) -> None:
        self.folder, self._mounted = folder, mounted

    @contextmanager
    def full(self, left: int = 0) -> Iterator[None]:
        """Inside, no more than ``left`` bytes fit."""
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
                with contextlib.suppress(OSError):  # full: that is what it is for
                    while free_bytes(self.folder) > left:
                        file.write(bytes(size))
        try:
            yield
        finally:
            ballast.unlink()


def free_bytes(folder: Path) -> int:
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize


@pytest.fixture
def small_disk(tmp_path) -> Iterator[SmallDisk]:
    folder = tmp_path / "small"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder)]
    mounted = os.geteuid() == 0 and subprocess.run(command, capture_output=True, check=False).returncode == 0
    yield SmallDisk(folder, mounted)
    if mounted:
        subprocess.run(["umount", "-l", str(folder)], check=True, capture_output=True)


def test_a_capture_on_a_full_disk_holds_whole_records_only_and_goes_on(small_disk):
    """What does not fit leaves nothing of itself; the next that fits is written."""
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


def test_the_contact_outlives_a_full_disk_and_the_hole_is_told(small_disk, sensor_in_memory, database, bus, clock):
    """The line goes on without its capture; the bytes that are missing there are counted, announced and an alarm."""
    sensor = sensor_in_memory()
    events = LineEventQueue(clock, sensor.monotonic_s)
    link = LinkService(DICTIONARY, database, bus, small_disk.folder, clock, sensor.monotonic_s, events)
    telemetry = TelemetryService(DICTIONARY, database, bus, clock, lambda: None, lambda: True)
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
        until(lambda: telemetry.latest_packet("housekeeping").device_time_s > before + 2, "the line to go on")
    until(lambda: not link.capture.fails, "the capture to go on")
    watch.tick()
    assert alarms.opened()[0].row.state == "cleared"
    assert link.contact_id == contact
    link.stop()
    dispatcher.stop()
    texts = [event.text for event in bus.after(0, 500)]
    assert len([t for t in texts if "record has a hole" in t]) == 1
    assert any(f"{link.capture.lost_bytes} bytes of the line are not in it" in t for t in texts)
    torn: list[int] = []
    assert len(list(read_captures(capture_files(small_disk.folder), lambda _, n: torn.append(n)))) > 3
    assert torn == []


def housekeeping(k: int) -> tuple[Telemetry]:
    fields = {"supply_3v3_v": 3.3, "mode": "standby", "cycle_running": False, "latchups": k}
    return (Telemetry("housekeeping", float(k), 0, fields, fields),)


def test_a_database_on_a_full_disk_loses_no_row_it_has_and_values_go_on(small_disk, clock, tmp_path):
    """Telemetry is judged and shown without a store; what was not stored is counted; the file stays whole."""
    url = f"sqlite:///{small_disk.folder / 'gss.db'}"
    # The pages that the file needs for its schema first; then the disk is full.
    migrate(url)
    database = Database(open_engine(url))
    bus = EventBus(database, clock)
    telemetry = TelemetryService(DICTIONARY, database, bus, clock, lambda: None, lambda: True)
    telemetry.handle(LineBatch(housekeeping(1), clock(), 0.0))
    with small_disk.full():
        for k in range(2, 2000):
            telemetry.handle(LineBatch(housekeeping(k), clock(), 10.0 * k))
            if telemetry.unstored > 20:
                break
        with pytest.raises(StoreDown, match="cannot be used now"):
            bus.record("x", "ok", "y" * 200_000)
        assert telemetry.latest_packet("housekeeping").values["latchups"] == k
        assert telemetry.store_fails
    telemetry.handle(LineBatch(housekeeping(k + 1), clock(), 10.0 * k + 10))
    assert telemetry.store_fails == ""
    assert any(f"{telemetry.unstored} packets of before" in event.text for event in bus.after(0, 100))
    with database.engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA integrity_check").scalar() == "ok"
        stored = connection.exec_driver_sql("SELECT count(*) FROM telemetry_packets").scalar()
    assert stored == k + 1 - telemetry.unstored
    database.close()


def test_bytes_on_a_full_disk_are_refused_and_no_half_file_stays(small_disk):
    """A frame that does not fit is not there; the others are."""
    blobs = BlobStore(str(small_disk.folder / "blobs"))
    kept = blobs.put(b"kept" * 1000)
    with small_disk.full(), pytest.raises(StoreDown, match="stored"):
        blobs.put(bytes(range(256)) * 2000)
    assert blobs.get(kept) == b"kept" * 1000
    assert list(blobs.keys()) == [kept]


def test_large_things_stop_before_the_disk_is_full_and_making_room_does_not(database, bus, clock, tmp_path):
    """Jobs, imports and downloads are refused with words while there is still room to say so; retention may always run."""
    room = [10_000]
    guard = DiskGuard(tmp_path, 5000, 1000, lambda _: (room[0], 20_000))
    jobs = JobService(database, bus, clock, guard.check)
    for kind in ("retention", "catalogue"):
        jobs.resumable(kind, lambda run: {})
    assert (guard.look().level, guard.has_room_for_rows()) == (State.OK, True)
    room[0] = 4000
    assert guard.look().level is State.WARNING
    guard.check("an import")
    with pytest.raises(StoreDown, match="no room for an import"):
        guard.check("an import", needed_bytes=3500)
    room[0] = 900
    assert (guard.look().level, guard.has_room_for_rows()) == (State.CRITICAL, True)
    with pytest.raises(StoreDown, match="nearly full"):
        jobs.begin("catalogue", "t", {})
    assert jobs.begin("retention", "t", {}).state == "queued"
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


def test_a_damaged_page_keeps_the_server_from_starting_and_names_the_way_out(database, bus, tmp_path, capsys):
    """Half a record is not served: the words name the check, the restore, and where the rest is."""
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


def test_a_page_that_is_damaged_while_the_server_runs_is_told(database, bus, tmp_path):
    """Whoever meets it gets the words, never a silent loss, and the database remembers it for the health page."""
    for k in range(300):
        bus.record("x", "ok", f"line {k} " + "." * 200)
    database.close()
    damage(tmp_path / "gss.db", "events")
    with pytest.raises(CorruptData, match="damaged"):
        bus.after(0, 1000)
    assert "malformed" in database.damage


def test_pages_of_a_large_file_are_read_beside_the_work(database, bus, tmp_path, monkeypatch):
    """Above the size at which the start leaves it out; damage is told on the health page and on the record."""
    monkeypatch.setattr(engine, "QUICK_CHECK_BYTES", 1 << 30)
    small = PageCheck(database, bus)
    small.start()
    assert small.state == ""
    monkeypatch.setattr(engine, "QUICK_CHECK_BYTES", 0)
    for k in range(300):
        bus.record("x", "ok", f"line {k} " + "." * 200)
    whole = PageCheck(database, bus)
    whole.start()
    whole.wait()
    assert (whole.state, database.damage) == ("its pages were read after the start", "")
    database.close()
    damage(tmp_path / "gss.db", "telemetry_packets")
    migrate(f"sqlite:///{tmp_path / 'gss.db'}")
    check = PageCheck(database, bus)
    check.start()
    check.wait()
    assert database.damage
    assert "the database is damaged" in bus.after(0, 1000)[-1].text

"""A small store with all content that maintenance checks."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.jobs import JobService
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_capture import RawCapture
from gss.operations.line.link import LinkService
from gss.operations.line.raw_capture import RECEIVED
from gss.operations.upkeep.backup import BackupService
from gss.operations.upkeep.clock_trust import ClockTrust
from gss.operations.upkeep.disk import BackupDisk, DiskGuard
from gss.operations.upkeep.retention import RetentionService
from gss.store import devices, frames, telemetry
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Calibration, Catalogue, Frame, Solution, TelemetryPacket

MB = 1 << 20


@dataclass
class UpkeepStore:
    """Services with one folder and a disk whose free space the test sets."""

    folder: Path
    database: Database
    blobs: BlobStore
    jobs: JobService
    retention: RetentionService
    backups: BackupService
    link: LinkService
    disk: DiskGuard
    clock: Any
    room: list[int]
    trust: ClockTrust

    def add_frame(self, content: bytes, age_days: float, **values: Any) -> int:
        """Store a frame of one row received ``age_days`` ago, with a solution, and return its id."""
        at = self.clock() - timedelta(days=age_days)
        row: dict[str, Any] = {"source": "device", "name": "f", "taken": at, "received": at, "bits": 8, "dtype": "|u1"}
        row |= {"columns": len(content), "rows": 1, "complete": True, "rows_held": [[0, 0]], "parameters": {}}
        row |= {"sha256": self.blobs.put(content), **values}
        with self.database.unit_of_work() as session:
            frame = frames.add(session, Frame(**row))
            solution = {
                "origin": "ground",
                "chain": "c",
                "version": "1",
                "created": at,
                "outcome": "solved",
                "detail": {},
            }
            frames.add_solution(session, Solution(frame_id=frame.id, **solution))
        return frame.id

    def add_packets(self, packet: str, count: int, age_days: float, every_s: float, request_id: int = 0) -> None:
        """Store ``count`` packets of one kind, the first received ``age_days`` ago."""
        start = self.clock() - timedelta(days=age_days)
        rows = [
            TelemetryPacket(
                packet=packet,
                received=start + timedelta(seconds=k * every_s),
                device_time_s=k,
                request_id=request_id,
                values={"n": k},
            )
            for k in range(count)
        ]
        with self.database.unit_of_work() as session:
            telemetry.add_batch(session, rows)

    def end(self, job: Any) -> Any:
        """Return the job after its end."""
        for _ in range(4000):
            found = self.jobs.get(job.id)
            if found.finished is not None:
                return found
            threading.Event().wait(0.005)
        pytest.fail("the job did not end")

    def fill(self) -> None:
        """Store a contact with a capture, frames, a catalogue, and a calibration with its dark frame."""
        with self.database.unit_of_work() as session:
            contact = devices.open_contact(session, "socket://x", self.clock(), "contact-000001")
            capture = RawCapture(self.folder / "captures", contact.id)
            capture.write(1.0, RECEIVED, b"bytes of the line" * 9)
            capture.close()
            devices.update_contact(session, contact.id, captures=capture.files, ended=self.clock())
            image, dark = self.blobs.put(b"image of a bank"), self.blobs.put(b"a dark frame")
            names = {"name": "c", "profile": "p", "format": "f", "created": self.clock(), "author": "a"}
            facts = {"stars": 1, "pairs": 1, "size": 15, "request": {}, "manifest": {}, "report": {}}
            session.add(Catalogue(sha256=image, **names, **facts))
            found = {"request": {"dark_ids": [1]}, "values": {}, "result": {"dark_frame": {"key": dark}}}
            session.add(
                Calibration(profile="p", kind="dark", name="d", created=self.clock(), author="a", tool="t", **found)
            )
        for k in range(4):
            self.add_frame(bytes([k]) * 500, age_days=10 - k)

    def blob_path(self, content: bytes) -> Path:
        """Return the path of a blob with this content."""
        key = hashlib.sha256(content).hexdigest()
        return self.folder / "blobs" / key[:2] / key[2:]


@pytest.fixture
def store(database, bus, clock, tmp_path) -> Iterator[UpkeepStore]:
    """Empty store."""
    blobs, jobs = BlobStore(str(tmp_path / "blobs")), JobService(database, bus, clock, lambda _: None)
    link = LinkService(
        load_dictionary(),
        default_roles(load_dictionary()),
        database,
        bus,
        tmp_path / "captures",
        clock,
        lambda: 0.0,
        LineEventQueue(clock, lambda: 0.0),
    )
    room, lock = [100_000 * MB], tmp_path / "upkeep.lock"
    disk, backup_disk = (
        guard(tmp_path, 2000 * MB, 200 * MB, lambda _: (room[0], 200_000 * MB)) for guard in (DiskGuard, BackupDisk)
    )
    trust = ClockTrust(database, bus, clock, timedelta(days=30))
    trust.start()
    retention = RetentionService(database, blobs, jobs, bus, link, lock, clock, trust, 0.2)
    url = f"sqlite:///{tmp_path / 'gss.db'}"
    captures, packages, folder = tmp_path / "captures", tmp_path / "instruments", tmp_path / "backups"
    backups = BackupService(
        database, url, blobs, captures, packages, folder, lock, backup_disk, jobs, bus, clock, trust
    )
    yield UpkeepStore(tmp_path, database, blobs, jobs, retention, backups, link, disk, clock, room, trust)
    jobs.stop()

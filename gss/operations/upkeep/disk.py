"""Disk space: large writes are rejected before the disk is full, so no file is left incomplete.

Below ``watch`` an alarm is raised. Below ``stop`` imports, downloads and builds are rejected. Below a quarter of ``stop``
decoded telemetry is no longer stored; the raw capture, which has priority and can be decoded later, still contains it.
Backups are rejected if the disk of their folder has less space than ``stop``.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gss.domain.errors import StoreDown
from gss.domain.limits import State
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarm_text import STORE
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.limit_check import Key
from gss.operations.telemetry.telemetry import TelemetryService

LAST_SHARE = 4
DISK: Key = (STORE, "disk")
CAPTURE: Key = (STORE, "raw capture")
TELEMETRY: Key = (STORE, "telemetry record")
Usage = Callable[[Path], tuple[int, int]]


def usage_of(folder: Path) -> tuple[int, int]:
    """Return (free, total) bytes of a folder's file system, as available without privileges. The folder need not exist."""
    usage = shutil.disk_usage(next(path for path in (folder, *folder.parents) if path.exists()))
    return usage.free, usage.total


@dataclass(frozen=True)
class DiskState:
    """Free disk space and the resulting state."""

    free_bytes: int
    total_bytes: int
    level: State
    text: str


class DiskGuard:
    """Checks the disk space before large writes."""

    name = "disk"
    stopped = "imports, downloads and backups to this disk"
    hint = "free space, or let retention remove old pixels (Admin, Storage)"

    def __init__(self, folder: Path, watch_bytes: int, stop_bytes: int, usage: Usage = usage_of) -> None:
        self.folder, self.watch_bytes, self.stop_bytes = folder, watch_bytes, stop_bytes
        self._usage = usage

    def look(self) -> DiskState:
        """Return the current state of the disk."""
        free, total = self._usage(self.folder)
        text = f"{megabytes(free)} of {megabytes(total)} free"
        if free < self.stop_bytes:
            return DiskState(free, total, State.CRITICAL, f"{text}: {self.stopped} are stopped")
        level = State.WARNING if free < self.watch_bytes else State.OK
        return DiskState(free, total, level, text)

    def check(self, purpose: str, needed_bytes: int = 0) -> None:
        """Raise StoreDown if writing ``needed_bytes`` would leave too little space. ``purpose``: operation, for the
        message."""
        free, _ = self._usage(self.folder)
        if free - needed_bytes < self.stop_bytes:
            raise StoreDown(
                f"the {self.name} is nearly full: no room for {purpose}",
                expected=f"at least {megabytes(self.stop_bytes + needed_bytes)} free",
                got=megabytes(free),
                hint=self.hint,
            )

    def has_room_for_rows(self) -> bool:
        """True if there is enough space for decoded telemetry. The last space is reserved for captures, commands and
        alarms."""
        return self._usage(self.folder)[0] >= self.stop_bytes // LAST_SHARE


class BackupDisk(DiskGuard):
    """Checks the disk of the backups, which can be separate from the disk of the data."""

    name = "disk of the backups"
    stopped = "backups"
    hint = "free space, keep fewer backups (Admin, Backup), or set GSS_BACKUPS to a larger disk"


class DiskWatch:
    """Raises, updates and ends the alarms for low disk space and for captures or telemetry that cannot be written."""

    def __init__(self, disk: DiskGuard, alarms: AlarmService, link: LinkService, telemetry: TelemetryService) -> None:
        self._disk, self._alarms, self._link, self._telemetry = disk, alarms, link, telemetry

    def tick(self) -> None:
        """Update the alarms once."""
        room = self._disk.look()
        limit = ""
        if room.level is not State.OK:
            low = self._disk.stop_bytes if room.level is State.CRITICAL else self._disk.watch_bytes
            limit = f"below {megabytes(low)} free ({room.level})"
        self._alarms.watch(DISK, room.level, round(room.free_bytes / 1e9, 3), f"Disk: {room.text}", limit)
        lost, unstored = self._link.capture.lost_bytes, self._telemetry.unstored
        self._watch_writes(CAPTURE, self._link.capture.fails, lost, f"{lost} bytes are missing from it")
        self._watch_writes(
            TELEMETRY, self._telemetry.store_fails, unstored, f"{unstored} packets are in the raw capture only"
        )

    def _watch_writes(self, key: Key, reason: str, count: int, text: str) -> None:
        level = State.CRITICAL if reason else State.OK
        self._alarms.watch(
            key, level, float(count), f"{key[1].capitalize()}: {text}", f"not written: {reason}" if reason else ""
        )


def megabytes(count: float) -> str:
    """Format a number of bytes as MB or GB."""
    return f"{count / 1e9:.1f} GB" if count >= 1e10 else f"{count / 1e6:.0f} MB"

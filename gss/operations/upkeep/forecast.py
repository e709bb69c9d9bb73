"""Forecast of disk usage: current sizes, growth, time until the disk is full, and next removal by retention."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from gss.operations.upkeep.disk import DiskGuard
from gss.operations.upkeep.retention import RetentionService
from gss.operations.upkeep.retention_policy import DAY
from gss.store import upkeep as store
from gss.store.engine import Database

LOOK_BACK_DAYS = 7
YOUNGEST_DAYS = 1 / 24
"""Minimum age of a store for an estimate of its growth."""


@dataclass(frozen=True)
class Forecast:
    """Forecast of disk usage. ``bytes_per_day``: growth of the data that retention does not limit, averaged over the
    last week or the age of the store, whichever is shorter; None if the store is too young. ``full_in_days``: None if
    the growth is unknown or zero. ``backups_bytes``: backups on the same disk, which count as used but not as growing.
    ``next_removal``: None if nothing will be removed."""

    database_bytes: int
    frames_bytes: int
    captures_bytes: int
    backups_bytes: int
    free_bytes: int
    bytes_now: int
    bytes_per_day: float | None
    full_in_days: float | None
    next_removal: datetime | None
    removable_bytes: int


class ForecastService:
    """Forecasts the disk usage of a store. ``backups``: folder of the backups."""

    def __init__(self, database: Database, retention: RetentionService, disk: DiskGuard, backups: Path) -> None:
        self._database, self._retention, self._disk, self._backups = database, retention, disk, backups

    def now(self) -> Forecast:
        """Compute the forecast from the current store."""
        return _forecast(self._database, self._retention, self._disk, self._backups)


def _forecast(database: Database, retention: RetentionService, disk: DiskGuard, backups: Path) -> Forecast:
    now, policy = retention.now(), retention.policy()
    since = now - LOOK_BACK_DAYS * DAY
    with database.unit_of_work() as session:
        database_bytes = store.database_bytes(session)
        _, frames_bytes = store.pixel_bytes(session)
        _, new_frames_bytes = store.pixel_bytes(session, since)
        packets, new_packets = store.count_packets(session), store.count_packets(session, since=since)
        oldest_packet, oldest_row = store.oldest(session)
    files = retention.capture_sizes()
    captures_bytes = sum(file.bytes for file in files)
    new_captures = 0
    for path, size in files:
        with contextlib.suppress(FileNotFoundError):
            new_captures += size if path.stat().st_mtime >= since.timestamp() else 0
    # For a store younger than a week, growth is averaged over the age of the store.
    days = LOOK_BACK_DAYS if oldest_row is None else min(LOOK_BACK_DAYS, (now - oldest_row) / DAY)
    new_bytes = 0.0
    if not (policy.frames_gb or policy.frames_days):
        new_bytes += new_frames_bytes
    if not policy.telemetry_days:
        new_bytes += database_bytes * (new_packets / packets if packets else 0.0)
    if captures_bytes < retention.capture_bytes():
        new_bytes += new_captures
    bytes_per_day = new_bytes / days if days >= YOUNGEST_DAYS else None
    backups_bytes = _bytes_on_same_disk(backups, disk.folder)
    free_bytes = disk.look().free_bytes
    available_bytes = max(0, free_bytes - disk.stop_bytes)
    removable = list(retention.going(policy, now))
    unprotected = retention.unprotected(policy) if policy.frames_days else []
    oldest_frame = min((pixels.received for pixels in unprotected), default=None)
    return Forecast(
        database_bytes,
        frames_bytes,
        captures_bytes,
        backups_bytes,
        free_bytes,
        database_bytes + frames_bytes + captures_bytes + backups_bytes,
        bytes_per_day,
        available_bytes / bytes_per_day if bytes_per_day else None,
        now
        if removable
        else _next_removal(now, policy.frames_days, oldest_frame, policy.telemetry_days, oldest_packet),
        sum(pixels.size for pixels in removable),
    )


def _bytes_on_same_disk(folder: Path, other: Path) -> int:
    """Return the size of a folder's content; 0 if it is missing or on another disk than ``other``."""
    if not folder.is_dir() or folder.stat().st_dev != other.stat().st_dev:
        return 0
    total = 0
    for path in folder.rglob("*"):
        with contextlib.suppress(FileNotFoundError):  # a backup can be removed at the same time
            total += path.lstat().st_size if path.is_file() else 0
    return total


def _next_removal(
    at: datetime, frames_days: float, frame: datetime | None, packet_days: float, packet: datetime | None
) -> datetime | None:
    """Return the time at which the oldest frame or packet becomes old enough for removal; None if there is none."""
    pairs = ((frames_days, frame), (packet_days, packet))
    moments = [oldest + timedelta(days=days) for days, oldest in pairs if days and oldest is not None]
    return max(at, min(moments)) if moments else None

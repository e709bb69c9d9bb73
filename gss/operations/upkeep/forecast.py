"""Forecast of disk usage: current sizes, growth, when the disk is full, and what retention removes next."""

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
"""A store younger than this has no meaningful growth rate."""


@dataclass(frozen=True)
class Forecast:
    """``bytes_per_day``: growth over the last week, or the shorter life of the store, of data that retention does not limit;
    None: too young. ``full_in_days`` None: unknown, no growth, or limited by retention. ``backups_bytes``: backups on the
    same disk, counted as used but not as growing. ``next_removal`` None: nothing will be removed."""

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
    """Forecasts the disk usage of a store. ``backups``: their folder."""

    def __init__(self, database: Database, retention: RetentionService, disk: DiskGuard, backups: Path) -> None:
        self._database, self._retention, self._disk, self._backups = database, retention, disk, backups

    def now(self) -> Forecast:
        """Compute the forecast from the current store."""
        return _forecast(self._database, self._retention, self._disk, self._backups)


def _forecast(database: Database, retention: RetentionService, disk: DiskGuard, backups: Path) -> Forecast:
    at, policy = retention.now(), retention.policy()
    since = at - LOOK_BACK_DAYS * DAY
    with database.unit_of_work() as session:
        used = store.database_bytes(session)
        _, frames = store.pixel_bytes(session)
        _, new_frames = store.pixel_bytes(session, since)
        packets, new_packets = store.count_packets(session), store.count_packets(session, since=since)
        oldest_frame, oldest_packet, first = store.oldest(session)
    files = retention.capture_sizes()
    captured = sum(file.bytes for file in files)
    new_captures = 0
    for path, size in files:
        with contextlib.suppress(FileNotFoundError):
            new_captures += size if path.stat().st_mtime >= since.timestamp() else 0
    # For a store younger than a week, growth is averaged over its life.
    days = LOOK_BACK_DAYS if first is None else min(LOOK_BACK_DAYS, (at - first) / DAY)
    new = 0.0
    if not (policy.frames_gb or policy.frames_days):
        new += new_frames
    if not policy.telemetry_days:
        new += used * (new_packets / packets if packets else 0.0)
    if captured < retention.capture_bytes():
        new += new_captures
    grows = new / days if days >= YOUNGEST_DAYS else None
    backed = _bytes_beside(backups, disk.folder)
    free = disk.look().free_bytes
    room = max(0, free - disk.stop_bytes)
    going = list(retention.going(policy, at))
    return Forecast(
        used,
        frames,
        captured,
        backed,
        free,
        used + frames + captured + backed,
        grows,
        room / grows if grows else None,
        at if going else _next(at, policy.frames_days, oldest_frame, policy.telemetry_days, oldest_packet),
        sum(pixels.size for pixels in going),
    )


def _bytes_beside(folder: Path, other: Path) -> int:
    """Return the size of a folder's content; 0 if it is missing or on another disk than ``other``."""
    if not folder.is_dir() or folder.stat().st_dev != other.stat().st_dev:
        return 0
    total = 0
    for path in folder.rglob("*"):
        with contextlib.suppress(FileNotFoundError):  # a backup may be pruned meanwhile
            total += path.lstat().st_size if path.is_file() else 0
    return total


def _next(
    at: datetime, frames_days: float, frame: datetime | None, packet_days: float, packet: datetime | None
) -> datetime | None:
    """Return when the first item becomes old enough for removal."""
    pairs = ((frames_days, frame), (packet_days, packet))
    moments = [oldest + timedelta(days=days) for days, oldest in pairs if days and oldest is not None]
    return max(at, min(moments)) if moments else None

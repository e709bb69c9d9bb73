"""What is on the disk, how fast it grows, when it is full, and what retention removes next."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from gss.operations.upkeep.disk import DiskGuard
from gss.operations.upkeep.retention import DAY, RetentionService
from gss.store import upkeep as store
from gss.store.engine import Database

LOOK_BACK_DAYS = 7


@dataclass(frozen=True)
class Forecast:
    """``bytes_per_day``: over the last week, of what keeps growing under the policy in force. ``full_in_days`` None: it does not
    grow, or retention holds it. ``next_removal`` None: nothing goes."""

    database_bytes: int
    frames_bytes: int
    captures_bytes: int
    free_bytes: int
    bytes_now: int
    bytes_per_day: float
    full_in_days: float | None
    next_removal: datetime | None
    removable_bytes: int


def forecast(database: Database, retention: RetentionService, disk: DiskGuard) -> Forecast:
    """Look at the store as it is."""
    at, policy = retention.now(), retention.policy()
    since = at - LOOK_BACK_DAYS * DAY
    with database.unit_of_work() as session:
        used = store.database_bytes(session)
        _, frames = store.pixel_bytes(session)
        _, new_frames = store.pixel_bytes(session, since)
        packets, new_packets = store.count_packets(session), store.count_packets(session, since=since)
        oldest_frame, oldest_packet, first = store.oldest(session)
    files = retention.capture_files()
    captured = sum(path.stat().st_size for path in files)
    new_captures = sum(path.stat().st_size for path in files if path.stat().st_mtime >= since.timestamp())
    # A young installation has not run for a week: its growth is over the days that it has.
    days = LOOK_BACK_DAYS if first is None else min(LOOK_BACK_DAYS, max(1.0, (at - first) / DAY))
    grows = 0.0
    if not (policy.frames_gb or policy.frames_days):
        grows += new_frames / days
    if not policy.telemetry_days:
        grows += used * (new_packets / packets if packets else 0.0) / days
    if captured < retention.capture_bytes():
        grows += new_captures / days
    free = disk.look().free_bytes
    room = max(0, free - disk.stop_bytes)
    going = list(retention.going(policy, at))
    return Forecast(
        used,
        frames,
        captured,
        free,
        used + frames + captured,
        grows,
        room / grows if grows > 0 else None,
        at if going else _next(at, policy.frames_days, oldest_frame, policy.telemetry_days, oldest_packet),
        sum(pixels.size for pixels in going),
    )


def _next(
    at: datetime, frames_days: float, frame: datetime | None, packet_days: float, packet: datetime | None
) -> datetime | None:
    """When the first thing becomes old enough."""
    pairs = ((frames_days, frame), (packet_days, packet))
    moments = [oldest + timedelta(days=days) for days, oldest in pairs if days and oldest is not None]
    return max(at, min(moments)) if moments else None

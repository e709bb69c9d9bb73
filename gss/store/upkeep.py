"""Queries for maintenance: referenced blobs, stored amounts, and deletion of expired rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from sqlalchemy import ColumnElement, case, delete, func, inspect, select, text, update
from sqlalchemy.orm import Session

from gss.store.models import (
    Alarm,
    Analysis,
    ApiToken,
    AuditRow,
    Base,
    Calibration,
    Catalogue,
    Command,
    Contact,
    DeviceTable,
    Event,
    Frame,
    Job,
    ListRun,
    OneTimeLink,
    SignIn,
    StarList,
    TelemetryPacket,
    Transfer,
)
from gss.store.transfers import ENDED

BATCH = 2000
PIXEL_BYTES = {"|u1": 1, "|i1": 1, "<u2": 2, "<i2": 2, "<f4": 4, "<f8": 8}


@dataclass(frozen=True)
class Reference:
    """Reference to a blob. ``by``: text that names the referring row; ``size``: expected size in bytes, None if
    unknown."""

    sha256: str
    by: str
    size: int | None = None


def references(session: Session) -> Iterator[Reference]:
    """Yield every blob reference in the database."""
    frames = select(Frame.id, Frame.sha256, Frame.dtype, Frame.columns * Frame.rows)
    for row_id, sha256, dtype, pixels in session.execute(frames.where(Frame.pixels_removed.is_(None))):
        yield Reference(sha256, f"frame {row_id}", pixels * PIXEL_BYTES[dtype] if dtype in PIXEL_BYTES else None)
    for model, label in (
        (Catalogue, "catalogue"),
        (DeviceTable, "table"),
        (StarList, "star list"),
        (ListRun, "uploaded lists"),
    ):
        for row_id, sha256, size in session.execute(select(model.id, model.sha256, model.size)):
            yield Reference(sha256, f"{label} {row_id}", size)
    results = select(ListRun.id, ListRun.results_sha256, ListRun.results_size).where(ListRun.results_sha256 != "")
    for row_id, sha256, size in session.execute(results):
        yield Reference(sha256, f"results of uploaded lists {row_id}", size)
    uploads = select(Transfer.id, Transfer.options).where(Transfer.direction == "up", Transfer.state.not_in(ENDED))
    for row_id, options in session.execute(uploads):
        if options.get("content"):
            yield Reference(options["content"], f"transfer {row_id}")
    for row_id, result in session.execute(select(Calibration.id, Calibration.result)):
        dark = result.get("dark_frame")
        key = dark.get("key", "") if isinstance(dark, dict) else ""
        if key:
            yield Reference(key, f"dark frame of calibration {row_id}")


def still_needed(session: Session, keys: Sequence[str]) -> set[str]:
    """Return the keys of deleted frames' blobs that another row still refers to."""
    needed: set[str] = set()
    for model in (Catalogue, DeviceTable, StarList, ListRun):
        needed |= set(session.scalars(select(model.sha256).where(model.sha256.in_(keys))))
    results = select(ListRun.results_sha256).where(ListRun.results_sha256.in_(keys))
    needed |= set(session.scalars(results))
    kept_frames = select(Frame.sha256).where(Frame.sha256.in_(keys), Frame.pixels_removed.is_(None))
    needed |= set(session.scalars(kept_frames))
    for options in session.scalars(select(Transfer.options).where(Transfer.state.not_in(ENDED))):
        needed |= {options.get("content", "")} & set(keys)
    return needed


# --- frames -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pixels:
    """Stored pixels: their frame, time of receipt and size in the store."""

    frame_id: int
    sha256: str
    received: datetime
    size: int


def pixels_held(session: Session) -> Iterator[Pixels]:
    """Yield every frame that has pixels and is not a favourite, oldest first."""
    columns = (Frame.id, Frame.sha256, Frame.received, _stored_bytes())
    query = select(*columns).where(Frame.pixels_removed.is_(None), Frame.favourite.is_(False)).order_by(Frame.id)
    for row_id, sha256, received, size in session.execute(query.execution_options(yield_per=BATCH)):
        yield Pixels(row_id, sha256, received, size)


def pixel_bytes(session: Session, since: datetime | None = None) -> tuple[int, int]:
    """Return (number of frames with pixels, size of the pixels in the store in bytes) for frames received at or after
    ``since``."""
    query = select(func.count(), func.sum(_stored_bytes())).where(Frame.pixels_removed.is_(None))
    if since is not None:
        query = query.where(Frame.received >= since)
    count, total = session.execute(query).one()
    return count, int(total or 0)


def _stored_bytes() -> ColumnElement[int]:
    """Return the column expression for the size of a frame's pixels in the store, in bytes."""
    plain = Frame.columns * Frame.rows * case(PIXEL_BYTES, value=Frame.dtype, else_=2)
    return func.coalesce(Frame.stored_bytes, plain)


def used_by_studies(session: Session) -> set[int]:
    """Return the ids of frames used by calibrations and analyses. Their results can be verified only while the pixels
    exist."""
    used: set[int] = set()
    for model in (Calibration, Analysis):
        for request in session.scalars(select(model.request)):
            for name in ("frame_ids", "dark_ids", "other_ids", "flat_pairs"):
                used |= set(_numbers(request.get(name) or ()))
    return used


def _numbers(values: Iterable[Any]) -> Iterator[int]:
    for value in values:
        if isinstance(value, list | tuple):
            yield from _numbers(value)
        elif isinstance(value, int):
            yield value


def remove_pixels(session: Session, frame_ids: Sequence[int], at: datetime) -> set[int]:
    """Mark pixels as deleted, except those of favourites and studies. Return the ids of the frames; their rows are kept."""
    ids = set(frame_ids) - used_by_studies(session)
    held = update(Frame).where(Frame.id.in_(ids), Frame.pixels_removed.is_(None), Frame.favourite.is_(False))
    return set(session.scalars(held.values(pixels_removed=at).returning(Frame.id)))


@dataclass(frozen=True)
class Amounts:
    """Numbers of stored frames (with pixels), frames_bytes, packets and events. ``arrived``: amounts that were stored
    after the last removal."""

    stored: dict[str, int]
    arrived: dict[str, int]


def amounts(session: Session, last: datetime | None) -> Amounts:
    """Return the stored amounts. ``last``: time of the last removal; None: ``arrived`` is zero."""
    return Amounts(_amounts(session, None), _amounts(session, last) if last else dict.fromkeys(AMOUNTS, 0))


AMOUNTS = ("frames", "frames_bytes", "packets", "events")


def _amounts(session: Session, since: datetime | None) -> dict[str, int]:
    events = select(func.count()).select_from(Event)
    if since is not None:
        events = events.where(Event.at >= since)
    values = (*pixel_bytes(session, since), count_packets(session, since=since), session.scalar(events) or 0)
    return dict(zip(AMOUNTS, values, strict=True))


def newest_row(session: Session) -> datetime | None:
    """Return the latest timestamp in the last rows of all recorded tables; None for an empty store."""
    columns = (
        (Event.at, Event.seq),
        (TelemetryPacket.received, TelemetryPacket.id),
        (Frame.received, Frame.id),
        (Command.created, Command.id),
        (AuditRow.at, AuditRow.seq),
        (Contact.started, Contact.id),
        (Job.created, Job.id),
    )
    times = [session.scalar(select(time).order_by(key.desc()).limit(1)) for time, key in columns]
    return max((time for time in times if time is not None), default=None)


def set_favourite(session: Session, frame_id: int, favourite: bool) -> None:
    """Set or remove the favourite mark of a frame. Retention never deletes a favourite's pixels."""
    session.execute(update(Frame).where(Frame.id == frame_id).values(favourite=favourite))


# --- packets and events -----------------------------------------------------------------------------------------


def packet_kinds(session: Session) -> list[str]:
    """Return the names of stored packets."""
    return sorted(session.scalars(select(TelemetryPacket.packet).distinct()))


def count_packets(session: Session, before: datetime | None = None, since: datetime | None = None) -> int:
    """Return the number of stored packets in a time range."""
    query = select(func.count()).select_from(TelemetryPacket)
    if before is not None:
        query = query.where(TelemetryPacket.received < before)
    if since is not None:
        query = query.where(TelemetryPacket.received >= since)
    return session.scalar(query) or 0


def remove_packets(session: Session, packet: str, before: datetime, limit: int = BATCH) -> int:
    """Delete the oldest packets of one kind, at most ``limit``. Returns the number deleted."""
    old = select(TelemetryPacket.id).where(TelemetryPacket.packet == packet, TelemetryPacket.received < before)
    ids = list(session.scalars(old.order_by(TelemetryPacket.received).limit(limit)))
    _remove(session, ids)
    return len(ids)


def thin_packets(
    session: Session, packet: str, after: datetime | None, before: datetime, every_s: float, limit: int = BATCH
) -> tuple[int, datetime | None]:
    """Keep only the first unsolicited packet in each interval of ``every_s``. Return the number of deleted packets and
    the time from which to continue, None at the end of the range."""
    rows = select(TelemetryPacket.id, TelemetryPacket.received).where(
        TelemetryPacket.packet == packet, TelemetryPacket.request_id == 0, TelemetryPacket.received < before
    )
    if after is not None:
        rows = rows.where(TelemetryPacket.received >= after)
    packets = session.execute(rows.order_by(TelemetryPacket.received, TelemetryPacket.id).limit(limit)).all()
    removed: list[int] = []
    last, last_kept = None, None
    for row_id, received in packets:
        bucket = received.timestamp() // every_s
        if bucket == last:
            removed.append(row_id)
        else:
            last, last_kept = bucket, received
    _remove(session, removed)
    # The next call starts at the kept packet, so later packets in the same interval are deleted too.
    return len(removed), last_kept if len(packets) == limit else None


def _remove(session: Session, ids: Sequence[int]) -> None:
    if ids:
        session.execute(delete(TelemetryPacket).where(TelemetryPacket.id.in_(ids)))


def count_events(session: Session, before: datetime) -> int:
    """Return the number of events before a time."""
    return session.scalar(select(func.count()).select_from(Event).where(Event.at < before)) or 0


def remove_events(session: Session, before: datetime, limit: int = BATCH) -> int:
    """Delete the oldest events, at most ``limit``. Returns the number deleted."""
    ids = list(session.scalars(select(Event.seq).where(Event.at < before).order_by(Event.at).limit(limit)))
    if ids:
        session.execute(delete(Event).where(Event.seq.in_(ids)))
    return len(ids)


# --- whole database ---------------------------------------------------------------------------------------------


def database_bytes(session: Session) -> int:
    """Return the bytes used by the database, without free pages, and by its write-ahead log."""
    if session.get_bind().dialect.name == "sqlite":
        pages, free, size = (session.scalar(text(f"PRAGMA {p}")) for p in ("page_count", "freelist_count", "page_size"))
        database = session.scalar(text("SELECT file FROM pragma_database_list"))
        log = Path(f"{database}-wal")
        return (int(pages) - int(free)) * int(size) + (log.stat().st_size if log.exists() else 0)
    return int(session.scalar(text("SELECT pg_database_size(current_database())")) or 0)


def row_counts(session: Session) -> dict[str, int]:
    """Return the number of rows of each existing table."""
    existing_tables = set(inspect(session.connection()).get_table_names())
    tables = [t for t in Base.metadata.sorted_tables if t.name in existing_tables]
    return {t.name: session.scalar(select(func.count()).select_from(t)) or 0 for t in tables}


def schema_version(session: Session) -> str:
    """Return the schema revision of the database; "" if there is none."""
    if "alembic_version" not in inspect(session.connection()).get_table_names():
        return ""
    return str(session.scalar(text("SELECT version_num FROM alembic_version")) or "")


def integrity_problems(session: Session, limit: int = 20) -> list[str]:
    """Return the problems that SQLite's integrity check reports. Empty for PostgreSQL, which checks its files
    itself."""
    if session.get_bind().dialect.name != "sqlite":
        return []
    problems = [str(row[0]) for row in session.execute(text(f"PRAGMA integrity_check({limit})"))]
    return [] if problems == ["ok"] else problems


def broken_links(session: Session, limit: int = 20) -> list[str]:
    """Return rows that reference a missing row of another table."""
    if session.get_bind().dialect.name == "sqlite":
        rows = session.execute(text("PRAGMA foreign_key_check")).fetchmany(limit)
        return [f"{row[0]} row {row[1]} refers to a missing row of {row[2]}" for row in rows]
    broken = []
    for table in Base.metadata.sorted_tables:
        for key in table.foreign_keys:
            other = key.column.table.alias()
            query = select(func.count()).select_from(table.outerjoin(other, key.parent == other.c[key.column.name]))
            number = session.scalar(query.where(key.parent.is_not(None), other.c[key.column.name].is_(None)))
            if number:
                broken.append(f"{number} rows of {table.name} refer to a missing row of {key.column.table.name}")
    return broken[:limit]


def states(session: Session) -> Iterator[tuple[str, str, int]]:
    """Yield (commands | transfers | jobs | alarms, state, number of rows)."""
    pairs: tuple[tuple[str, Any], ...] = (
        ("commands", Command.result),
        ("transfers", Transfer.state),
        ("jobs", Job.state),
        ("alarms", Alarm.state),
    )
    for name, column in pairs:
        for state, number in session.execute(select(column, func.count()).group_by(column)):
            yield name, str(state), int(number)


def oldest(session: Session) -> tuple[datetime | None, datetime | None]:
    """Return the times of the oldest packet and the oldest event."""
    return session.scalar(select(func.min(TelemetryPacket.received))), session.scalar(select(func.min(Event.at)))


def frame_count(session: Session) -> int:
    """Return the number of stored frames, with or without pixels."""
    return session.scalar(select(func.count()).select_from(Frame)) or 0


# --- keys ---------------------------------------------------------------------------------------------------------


def close_keys(session: Session, now: datetime, reason: str) -> None:
    """Invalidate every session, one-time link and token. Users and passwords are kept."""
    session.execute(update(SignIn).where(SignIn.ended.is_(None)).values(ended=now, end_reason=reason))
    session.execute(update(OneTimeLink).where(OneTimeLink.used.is_(None)).values(used=now))
    session.execute(update(ApiToken).where(ApiToken.revoked.is_(None)).values(revoked=now))

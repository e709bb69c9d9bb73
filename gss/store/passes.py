"""Orbits of the spacecraft, ground stations and pass plans."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import Contact, OrbitSet, PassPlan, Station, Transfer

COMPLETE = ("verified", "done")
ACTIVE = ("armed", "running", "paused", "waiting")


def newest_orbits(session: Session, limit: int) -> list[OrbitSet]:
    """Return the latest orbits, newest first. The first is the active orbit."""
    return list(session.scalars(select(OrbitSet).order_by(OrbitSet.id.desc()).limit(limit)))


def nearest_orbits(session: Session, spacecraft: str, time: datetime, limit: int) -> list[OrbitSet]:
    """Return up to ``limit`` orbits of a spacecraft, sorted by the distance of their epoch from ``time``."""
    query = select(OrbitSet).where(OrbitSet.spacecraft == spacecraft).limit(limit)
    before = session.scalars(query.where(OrbitSet.epoch <= time).order_by(OrbitSet.epoch.desc()))
    after = session.scalars(query.where(OrbitSet.epoch > time).order_by(OrbitSet.epoch))
    return sorted([*before, *after], key=lambda row: abs(row.epoch - time))[:limit]


def add(session: Session, row: OrbitSet | Station | PassPlan) -> None:
    """Store a new row and assign its id."""
    session.add(row)
    session.flush()


def list_stations(session: Session) -> list[Station]:
    """Return all stations, sorted by name."""
    return list(session.scalars(select(Station).order_by(Station.name)))


def get_station(session: Session, station_id: int) -> Station:
    """Return the station with that id. Raises NotFound if it does not exist."""
    row = session.get(Station, station_id)
    if row is None:
        raise NotFound("no such ground station", got=str(station_id))
    return row


def station_named(session: Session, name: str) -> Station | None:
    """Return the station with that name."""
    return session.scalar(select(Station).where(Station.name == name))


def delete_station(session: Session, station_id: int) -> None:
    """Delete a station. Raises NotFound."""
    session.delete(get_station(session, station_id))


def newest_downloads(
    session: Session, min_bytes: int, limit: int, line_url: str = ""
) -> list[tuple[int, datetime, datetime]]:
    """Return (size, created, finished) of the newest downloads of at least ``min_bytes`` that were complete in the contact in
    which they began. ``line_url``: only of this line."""
    query = (
        select(Transfer.size, Transfer.created, Transfer.finished)
        .join(Contact, Contact.id == Transfer.contact_id)
        .where(Transfer.direction == "down", Transfer.state.in_(COMPLETE), Transfer.size >= min_bytes)
        .where(Transfer.finished.is_not(None), Contact.ended.is_(None) | (Contact.ended >= Transfer.finished))
        .order_by(Transfer.id.desc())
        .limit(limit)
    )
    if line_url:
        query = query.where(Contact.url == line_url)
    return [(size, created, finished) for size, created, finished in session.execute(query) if finished is not None]


def get_plan(session: Session, plan_id: int) -> PassPlan:
    """Return the plan with that id. Raises NotFound if it does not exist."""
    row = session.get(PassPlan, plan_id)
    if row is None:
        raise NotFound("no such pass plan", got=str(plan_id))
    return row


def newest_plans(session: Session, limit: int) -> list[PassPlan]:
    """Return the latest plans, newest first."""
    return list(session.scalars(select(PassPlan).order_by(PassPlan.id.desc()).limit(limit)))


def active_plans(session: Session) -> list[PassPlan]:
    """Return the plans that are armed or in progress, sorted by rise."""
    return list(session.scalars(select(PassPlan).where(PassPlan.state.in_(ACTIVE)).order_by(PassPlan.rise)))


def delete_plan(session: Session, row: PassPlan) -> None:
    """Delete a plan."""
    session.delete(session.merge(row))

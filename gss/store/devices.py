"""Devices and contacts."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any, TypeVar

from sqlalchemy import exists, func, select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import Command, Contact, Device, Event, Frame, TelemetryPacket, Transfer


def remember(
    session: Session,
    now: datetime,
    *,
    name: str,
    profile: str,
    firmware: str,
    simulated: bool | None,
    dictionary_hash: str,
) -> Device:
    """Create or update the device with that name, and return it."""
    device = session.scalar(select(Device).where(Device.name == name))
    if device is None:
        device = Device(name=name, first_seen=now)
        session.add(device)
    device.profile, device.firmware, device.simulated = profile, firmware, simulated
    device.dictionary_hash, device.last_seen = dictionary_hash, now
    session.flush()
    return device


def open_contact(session: Session, url: str, now: datetime, capture: str, *, contact_id: int | None = None) -> Contact:
    """Store a new contact on that address with the given id or the next free id."""
    contact = Contact(id=contact_id, url=url, started=now, capture=capture)
    session.add(contact)
    session.flush()
    if contact_id is not None and session.get_bind().dialect.name == "postgresql":
        # Explicit ids do not advance PostgreSQL's sequence.
        session.execute(select(func.setval(func.pg_get_serial_sequence("contacts", "id"), contact_id)))
    return contact


def reopen_contact(session: Session, contact_id: int) -> None:
    """Remove the end of a contact whose line is open again."""
    session.get_one(Contact, contact_id).ended = None


def last_contact_id(session: Session) -> int:
    """Return the highest contact id; 0 if there is none."""
    return session.scalar(select(func.max(Contact.id))) or 0


def had_contact(session: Session, url: str) -> bool:
    """True if a line was opened on that address before."""
    return bool(session.scalar(select(exists().where(Contact.url == url))))


def update_contact(
    session: Session,
    contact_id: int,
    *,
    device_id: int | None = None,
    rx_bytes: int | None = None,
    tx_bytes: int | None = None,
    captures: list[Any] | None = None,
    note: str | None = None,
    ended: datetime | None = None,
    instrument: str | None = None,
    instrument_version: str | None = None,
) -> None:
    """Update the columns of a contact whose values are not None."""
    contact = session.get_one(Contact, contact_id)
    values = {"device_id": device_id, "rx_bytes": rx_bytes, "tx_bytes": tx_bytes, "captures": captures, "note": note}
    values |= {"instrument": instrument, "instrument_version": instrument_version}
    for name, value in values.items():
        if value is not None:
            setattr(contact, name, value)
    if ended is not None:  # a contact must not end before its start, even if the clock was set back
        contact.ended = max(ended, contact.started)


def close_left_open(session: Session, now: datetime) -> None:
    """End contacts that a crash left open, at the time of their last stored packet, but not before their start if the
    clock was set back."""
    for contact in session.scalars(select(Contact).where(Contact.ended.is_(None))):
        last = session.scalar(
            select(func.max(TelemetryPacket.received)).where(TelemetryPacket.contact_id == contact.id)
        )
        contact.ended = max(contact.started, min(now, last or contact.started))


def list_contacts(session: Session, limit: int, offset: int = 0) -> list[tuple[Contact, Device | None, int, int]]:
    """Return the latest contacts, newest first, each with its device and its numbers of frames and commands."""
    frames = select(func.count(Frame.id)).where(Frame.contact_id == Contact.id).scalar_subquery()
    commands = select(func.count(Command.id)).where(Command.contact_id == Contact.id).scalar_subquery()
    query = (
        select(Contact, Device, frames, commands)
        .outerjoin(Device, Device.id == Contact.device_id)
        .order_by(Contact.id.desc())
        .offset(offset)
        .limit(limit)
    )
    return [(row[0], row[1], row[2], row[3]) for row in session.execute(query)]


def count_contacts(session: Session) -> int:
    """Return the number of contacts."""
    return session.scalar(select(func.count(Contact.id))) or 0


def get_contact(session: Session, contact_id: int) -> tuple[Contact, Device | None]:
    """Return a contact and its device. Raises NotFound if the contact does not exist."""
    row = session.get(Contact, contact_id)
    if row is None:
        raise NotFound("no such contact", got=str(contact_id))
    return row, session.get(Device, row.device_id) if row.device_id is not None else None


Recorded = TypeVar("Recorded", Frame, Command, Transfer)


def recorded(session: Session, kind: type[Recorded], contact_id: int, limit: int) -> tuple[list[Recorded], int]:
    """Return the latest rows of a contact, oldest first, and their total number. ``kind``: Frame, Command or
    Transfer."""
    of_contact = select(kind).where(kind.contact_id == contact_id)
    newest = session.scalars(of_contact.order_by(kind.id.desc()).limit(limit)).all()
    total = session.scalar(select(func.count()).select_from(of_contact.with_only_columns(kind.id).subquery())) or 0
    return list(reversed(newest)), total


def downloaded_bytes(session: Session, contact_id: int, kinds: Sequence[str]) -> int:
    """Return the total size of a contact's downloads of these kinds."""
    total = select(func.sum(Transfer.size)).where(Transfer.contact_id == contact_id, Transfer.direction == "down")
    return int(session.scalar(total.where(Transfer.kind.in_(kinds))) or 0)


def count_events(session: Session, start: datetime, end: datetime) -> int:
    """Return the number of events in a time range."""
    return session.scalar(select(func.count(Event.seq)).where(Event.at >= start, Event.at <= end)) or 0


def events_between(session: Session, start: datetime, end: datetime, kinds: Sequence[str] = ()) -> list[Event]:
    """Return events in a time range, oldest first. ``kinds``: kinds to include; empty: all."""
    query = select(Event).where(Event.at >= start, Event.at <= end).order_by(Event.seq)
    return list(session.scalars(query.where(Event.kind.in_(kinds)) if kinds else query))


def clock_jumps(session: Session, start: datetime, end: datetime) -> list[Event]:
    """Return the events about jumps of the server clock in a time range, oldest first."""
    query = select(Event).where(Event.kind == "clock", Event.at >= start, Event.at <= end)
    return list(session.scalars(query.order_by(Event.seq)))


LINE_CLOSED = "Line closed: "
"""Beginning of the event that records why a line was closed; versions up to 0.4 wrote it in lower case."""


def closings(session: Session, contact_id: int) -> list[tuple[datetime, str]]:
    """Return when and why a contact's line was closed, as recorded, in order of time. A contact whose line was lost for a few
    seconds has several."""
    closed = func.lower(Event.text).startswith(LINE_CLOSED.lower(), autoescape=True)
    query = select(Event).where(Event.kind == "link", closed).order_by(Event.seq.desc()).limit(2000)
    events = [event for event in session.scalars(query) if event.data.get("contact_id") == contact_id]
    return [(event.at, event.text[len(LINE_CLOSED) :]) for event in reversed(events)]

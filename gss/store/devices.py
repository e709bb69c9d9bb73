"""Devices and contacts."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from gss.store.models import Command, Contact, Device, Frame


def remember(
    session: Session,
    now: datetime,
    *,
    name: str,
    profile: str,
    firmware: str,
    simulated: bool,
    dictionary_hash: str,
) -> Device:
    """The device of that name, created or brought up to date."""
    device = session.scalar(select(Device).where(Device.name == name))
    if device is None:
        device = Device(name=name, first_seen=now)
        session.add(device)
    device.profile, device.firmware, device.simulated = profile, firmware, simulated
    device.dictionary_hash, device.last_seen = dictionary_hash, now
    session.flush()
    return device


def open_contact(session: Session, url: str, now: datetime, capture: str) -> Contact:
    """A new contact on that address."""
    contact = Contact(url=url, started=now, capture=capture)
    session.add(contact)
    session.flush()
    return contact


def update_contact(
    session: Session,
    contact_id: int,
    *,
    device_id: int | None = None,
    rx_bytes: int | None = None,
    tx_bytes: int | None = None,
    ended: datetime | None = None,
) -> None:
    """Set what is given."""
    contact = session.get_one(Contact, contact_id)
    for name, value in (("device_id", device_id), ("rx_bytes", rx_bytes), ("tx_bytes", tx_bytes), ("ended", ended)):
        if value is not None:
            setattr(contact, name, value)


def close_left_open(session: Session, now: datetime) -> None:
    """End contacts that a crash left open."""
    for contact in session.scalars(select(Contact).where(Contact.ended.is_(None))):
        contact.ended = now


def list_contacts(session: Session, limit: int) -> list[tuple[Contact, Device | None, int, int]]:
    """Newest contacts with their device and the numbers of frames and commands."""
    frames = select(func.count(Frame.id)).where(Frame.contact_id == Contact.id).scalar_subquery()
    commands = select(func.count(Command.id)).where(Command.contact_id == Contact.id).scalar_subquery()
    query = (
        select(Contact, Device, frames, commands)
        .outerjoin(Device, Device.id == Contact.device_id)
        .order_by(Contact.id.desc())
        .limit(limit)
    )
    return [(row[0], row[1], row[2], row[3]) for row in session.execute(query)]

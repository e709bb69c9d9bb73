"""Content of each device bank over time."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.store.models import BankHistory, Contact, Device


def add(session: Session, row: BankHistory) -> BankHistory:
    """Store a row and give it its id."""
    session.add(row)
    session.flush()
    return row


def still_so(session: Session, device_id: int) -> list[BankHistory]:
    """Return the current content of each bank of a device, as far as known on the ground; by bank."""
    query = select(BankHistory).where(BankHistory.device_id == device_id, BankHistory.ended.is_(None))
    return list(session.scalars(query.order_by(BankHistory.bank, BankHistory.id)))


def between(session: Session, device_id: int, start: datetime, end: datetime) -> list[BankHistory]:
    """Return bank contents at any time in a range, by bank, then by time."""
    query = select(BankHistory).where(
        BankHistory.device_id == device_id,
        BankHistory.began <= end,
        BankHistory.ended.is_(None) | (BankHistory.ended >= start),
    )
    return list(session.scalars(query.order_by(BankHistory.bank, BankHistory.began, BankHistory.id)))


def contacts_between(session: Session, device_id: int, start: datetime, end: datetime) -> list[Contact]:
    """Return contacts with a device at any time in a range, in order."""
    query = select(Contact).where(
        Contact.device_id == device_id, Contact.started <= end, Contact.ended.is_(None) | (Contact.ended >= start)
    )
    return list(session.scalars(query.order_by(Contact.started, Contact.id)))


def devices(session: Session) -> list[Device]:
    """Return devices with recorded banks, the one that responded last first."""
    device_ids = select(BankHistory.device_id).distinct()
    return list(session.scalars(select(Device).where(Device.id.in_(device_ids)).order_by(Device.last_seen.desc())))


def device_of_contact(session: Session, contact_id: int) -> int | None:
    """Return the device id of a contact; None until the device has identified itself."""
    contact = session.get(Contact, contact_id)
    return None if contact is None else contact.device_id

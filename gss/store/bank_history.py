"""Content of each device bank over time."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.store.models import BankHistory, Contact, Device


def add(session: Session, row: BankHistory) -> BankHistory:
    """Store a row and assign its id."""
    session.add(row)
    session.flush()
    return row


def still_so(session: Session, device_id: int) -> list[BankHistory]:
    """Return the last known content of each bank of a device, sorted by bank."""
    query = select(BankHistory).where(BankHistory.device_id == device_id, BankHistory.ended.is_(None))
    return list(session.scalars(query.order_by(BankHistory.bank, BankHistory.id)))


def between(session: Session, device_id: int, start: datetime, end: datetime) -> list[BankHistory]:
    """Return the contents of all banks during a time range, sorted by bank and time."""
    query = select(BankHistory).where(
        BankHistory.device_id == device_id,
        BankHistory.began <= end,
        BankHistory.ended.is_(None) | (BankHistory.ended >= start),
    )
    return list(session.scalars(query.order_by(BankHistory.bank, BankHistory.began, BankHistory.id)))


def contacts_between(session: Session, device_id: int, start: datetime, end: datetime) -> list[Contact]:
    """Return the contacts with a device that overlap a time range, oldest first."""
    query = select(Contact).where(
        Contact.device_id == device_id, Contact.started <= end, Contact.ended.is_(None) | (Contact.ended >= start)
    )
    return list(session.scalars(query.order_by(Contact.started, Contact.id)))


def devices(session: Session) -> list[Device]:
    """Return the devices with recorded banks, most recent response first."""
    device_ids = select(BankHistory.device_id).distinct()
    return list(session.scalars(select(Device).where(Device.id.in_(device_ids)).order_by(Device.last_seen.desc())))


def device_of_contact(session: Session, contact_id: int) -> int | None:
    """Return the device id of a contact; None until the device has identified itself."""
    contact = session.get(Contact, contact_id)
    return None if contact is None else contact.device_id

"""Uploads and downloads."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import Transfer

ENDED = ("verified", "committed", "active", "failed", "aborted", "done")


def add(session: Session, transfer: Transfer) -> Transfer:
    """Store a transfer's row and assign its id."""
    session.add(transfer)
    session.flush()
    return transfer


def get(session: Session, transfer_id: int) -> Transfer:
    """Return the transfer with that id. Raises NotFound if it does not exist."""
    row = session.get(Transfer, transfer_id)
    if row is None:
        raise NotFound("no such transfer", got=str(transfer_id))
    return row


def newest(session: Session, limit: int) -> list[Transfer]:
    """Return the latest transfers, newest first."""
    return list(session.scalars(select(Transfer).order_by(Transfer.id.desc()).limit(limit)))


def unfinished(session: Session) -> list[Transfer]:
    """Return transfers that the previous run of the server left unfinished, oldest first."""
    return list(session.scalars(select(Transfer).where(Transfer.state.not_in(ENDED)).order_by(Transfer.id)))


def mark_active(session: Session, kind: str, sha256: str) -> list[Transfer]:
    """Mark the newest upload with this content as active and other active uploads of its kind as committed. Return the
    changed rows."""
    of_kind = select(Transfer).where(Transfer.direction == "up", Transfer.kind == kind)
    uploads = of_kind.where(Transfer.state.in_(("committed", "active")), Transfer.sha256 == sha256)
    newest = session.scalar(uploads.order_by(Transfer.id.desc()).limit(1))
    changed = [row for row in session.scalars(of_kind.where(Transfer.state == "active")) if row is not newest]
    for row in changed:
        row.state = "committed"
    if newest is not None and newest.state != "active":
        newest.state = "active"
        changed.append(newest)
    return changed

"""Built catalogues."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import Catalogue


def add(session: Session, catalogue: Catalogue) -> Catalogue:
    """Store a catalogue's row and assign its id."""
    session.add(catalogue)
    session.flush()
    return catalogue


def get(session: Session, catalogue_id: int) -> Catalogue:
    """Return the catalogue with that id. Raises NotFound if it does not exist."""
    row = session.get(Catalogue, catalogue_id)
    if row is None:
        raise NotFound("no such catalogue", got=str(catalogue_id))
    return row


def by_sha256(session: Session, sha256: str) -> Catalogue | None:
    """Return the latest catalogue with that image hash; a prefix of 8 or more digits is sufficient."""
    return session.scalar(
        select(Catalogue).where(Catalogue.sha256.startswith(sha256)).order_by(Catalogue.id.desc()).limit(1)
    )


def newest(session: Session, limit: int) -> list[Catalogue]:
    """Return the latest catalogues, newest first."""
    return list(session.scalars(select(Catalogue).order_by(Catalogue.id.desc()).limit(limit)))

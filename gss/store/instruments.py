"""Which rows were made with which instrument."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from gss.store.models import Catalogue, Contact, Frame


@dataclass(frozen=True)
class UseCount:
    """Numbers of rows made with one version of an instrument; ``version`` None: unknown."""

    name: str
    version: str | None
    frames: int
    contacts: int
    catalogues: int


def uses(session: Session) -> list[UseCount]:
    """Return the use of every version of every instrument that a row names, sorted by name."""
    counts: dict[tuple[str, str | None], list[int]] = {}
    columns = (
        (Frame.profile, Frame.instrument_version),
        (Contact.instrument, Contact.instrument_version),
        (Catalogue.profile, Catalogue.instrument_version),
    )
    for place, (name, version) in enumerate(columns):
        query = select(name, version, func.count()).where(name.is_not(None)).group_by(name, version)
        for key_name, key_version, count in session.execute(query):
            counts.setdefault((str(key_name), key_version), [0, 0, 0])[place] = count
    rows = sorted(counts.items(), key=lambda item: (item[0][0], item[0][1] or ""))
    return [UseCount(name, version, *three) for (name, version), three in rows]

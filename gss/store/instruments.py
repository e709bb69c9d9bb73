"""Count the stored rows of each instrument."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from gss.store.models import Catalogue, Contact, Frame


@dataclass(frozen=True)
class UseCount:
    """Numbers of stored rows of one version of an instrument. ``version`` None: unknown."""

    name: str
    version: str | None
    frames: int
    contacts: int
    catalogues: int


def uses(session: Session) -> list[UseCount]:
    """Return the row counts of every version of every instrument in the store, sorted by name."""
    counts: dict[tuple[str, str | None], list[int]] = {}
    columns = (
        (Frame.profile, Frame.instrument_version),
        (Contact.instrument, Contact.instrument_version),
        (Catalogue.profile, Catalogue.instrument_version),
    )
    for column, (name, version) in enumerate(columns):
        query = select(name, version, func.count()).where(name.is_not(None)).group_by(name, version)
        for key_name, key_version, count in session.execute(query):
            counts.setdefault((str(key_name), key_version), [0, 0, 0])[column] = count
    rows = sorted(counts.items(), key=lambda item: (item[0][0], item[0][1] or ""))
    return [UseCount(name, version, *numbers) for (name, version), numbers in rows]

"""Command authority."""

from __future__ import annotations

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc


class TenureOut(Out):
    """One holder, from taking to the end."""

    holder: str
    taken: Utc
    ended: Utc | None
    ended_by: str
    reason: str


class AuthorityOut(Out):
    """Who may command now, and who did before, newest first. ``mine``: the one who asks holds it; always false on the
    stream, which does not know who listens."""

    holder: str | None
    since: Utc | None
    mine: bool
    history: list[TenureOut]


class BreakIn(In):
    """Why command authority is taken from its holder."""

    reason: str = Field(min_length=1, max_length=300)

"""Command authority."""

from __future__ import annotations

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc


class TenureOut(Out):
    """One holder of command authority, from taking to losing it."""

    holder: str
    taken: Utc
    ended: Utc | None
    ended_by: str
    reason: str


class AuthorityOut(Out):
    """Holder of command authority and earlier holders, newest first. ``mine``: the caller holds it; always false on the
    stream, which is shared by all listeners."""

    holder: str | None
    since: Utc | None
    mine: bool
    history: list[TenureOut]


class BreakIn(In):
    """Reason for taking command authority from its holder."""

    reason: str = Field(min_length=1, max_length=300)

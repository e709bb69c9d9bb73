"""Command authority."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc


class TenureOut(Out):
    """One holder of command authority, from taking to losing it."""

    holder: str
    taken: Utc
    ended: Utc | None
    ended_by: str
    reason: str


class AuthorityTransferOut(Out):
    """Hand-over that waits for an answer. ``request``: ``user`` requests authority from the holder; ``offer``: the holder
    offers it to ``user``."""

    kind: Literal["request", "offer"]
    user: str
    note: str
    at: Utc


class AuthorityOut(Out):
    """Holder of command authority and earlier holders, newest first. ``mine``: the caller holds it; always false on the
    stream, which is shared by all listeners. ``transfer``: null if no request or offer waits for an answer."""

    holder: str | None
    since: Utc | None
    mine: bool
    transfer: AuthorityTransferOut | None
    history: list[TenureOut]


class AuthorityNoteIn(In):
    """Note of a request, or of the answer to a request or offer."""

    note: str = Field(default="", max_length=300)


class AuthorityOfferIn(AuthorityNoteIn):
    """User to whom the holder offers command authority, with a note."""

    user: str = Field(min_length=1, max_length=60)


class BreakIn(In):
    """Reason for taking command authority from its holder."""

    reason: str = Field(min_length=1, max_length=300)

"""Command authority."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc


class TenureOut(Out):
    """Period in which one user held command authority."""

    holder: str
    taken: Utc
    ended: Utc | None
    ended_by: str
    reason: str


class AuthorityTransferOut(Out):
    """Pending transfer of command authority. ``request``: ``user`` requests authority from the holder; ``offer``: the
    holder offers it to ``user``."""

    kind: Literal["request", "offer"]
    user: str
    note: str
    at: Utc


class AuthorityOut(Out):
    """Current and earlier holders of command authority, newest first. ``mine``: true if the caller is the holder;
    always false on the stream, which is shared by all listeners. ``transfer``: null if no request or offer is
    pending."""

    holder: str | None
    since: Utc | None
    mine: bool
    transfer: AuthorityTransferOut | None
    history: list[TenureOut]


class AuthorityNoteIn(In):
    """Note with a request, or with the answer to a request or offer."""

    note: str = Field(default="", max_length=300)


class AuthorityOfferIn(AuthorityNoteIn):
    """User to whom the holder offers command authority, with a note."""

    user: str = Field(min_length=1, max_length=60)


class BreakIn(In):
    """Reason for taking command authority from its holder."""

    reason: str = Field(min_length=1, max_length=300)

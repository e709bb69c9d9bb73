"""Shared views of the console."""

from __future__ import annotations

from pydantic import Field

from gss.api.schemas.base import Out, Utc
from gss.operations.views.shared_views import ViewRequest


class ViewChangeIn(ViewRequest):
    """Changed view. ``version``: the version that was changed."""

    version: int = Field(ge=1, le=1_000_000_000)


class ViewOut(Out):
    """Stored view. ``user`` and ``changed``: who stored the newest version, and when."""

    id: int
    name: str
    path: str
    note: str
    owner: str
    open: bool
    version: int
    user: str
    changed: Utc


class ViewVersionOut(Out):
    """Version of a view."""

    version: int
    name: str
    path: str
    note: str
    user: str
    changed: Utc


class ViewDetailOut(ViewOut):
    """View with its versions, newest first."""

    versions: list[ViewVersionOut]

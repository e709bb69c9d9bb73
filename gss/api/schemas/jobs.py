"""Background jobs."""

from __future__ import annotations

from gss.api.schemas.base import Out, Utc
from gss.domain.json_object import JsonObject


class JobOut(Out):
    """Job. ``state``: queued, running, done, failed or cancelled. ``attempts``: number of server crashes while it ran,
    since its last progress. ``can_start_again``: it has ended, and its stored request is sufficient to repeat it.
    ``user``: who started it and may cancel it, in addition to users with ``permission``."""

    id: int
    kind: str
    user: str
    permission: str
    title: str
    state: str
    done: int
    total: int
    text: str
    created: Utc
    finished: Utc | None
    result: JsonObject
    attempts: int
    can_start_again: bool

"""Background jobs."""

from __future__ import annotations

from gss.api.schemas.base import Out, Utc
from gss.domain.json_object import JsonObject


class JobOut(Out):
    """Job. ``state``: queued, running, done, failed or cancelled; a started job is running until its cancellation takes
    effect. ``attempts``: number of server crashes during the job since its last progress. ``can_start_again``: true if
    the job has ended and its stored request is sufficient to repeat it. ``user``: user who started the job; this user
    and users with ``permission`` can cancel it."""

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

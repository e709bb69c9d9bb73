"""Long work."""

from __future__ import annotations

from typing import Any

from gss.api.schemas.base import Out, Utc


class JobOut(Out):
    """A job. ``state``: queued, running, done, failed, cancelled. ``attempts``: servers that died over it since it last came
    further. ``can_start_again``: it has ended, and its stored request is enough to do it anew. ``user``: who started it and may
    end it, beside all who have ``permission``."""

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
    result: dict[str, Any]
    attempts: int
    can_start_again: bool

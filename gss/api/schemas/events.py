"""The record of what happened, and the stream."""

from __future__ import annotations

from typing import Any

from gss.api.schemas.base import Out, Utc


class EventOut(Out):
    """One event. ``seq`` only grows; the stream can be resumed after any of them."""

    seq: int
    at: Utc
    kind: str
    severity: str
    text: str
    data: dict[str, Any]

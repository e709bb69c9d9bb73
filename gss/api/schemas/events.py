"""Recorded events, also sent on the stream."""

from __future__ import annotations

from typing import Any

from gss.api.schemas.base import Out, Utc


class EventOut(Out):
    """Event. ``seq`` only increases; the stream can be resumed after any event."""

    seq: int
    at: Utc
    kind: str
    severity: str
    text: str
    data: dict[str, Any]

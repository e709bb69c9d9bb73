"""Recorded events, also sent on the stream."""

from __future__ import annotations

from gss.api.schemas.base import Out, Utc
from gss.domain.json_object import JsonObject


class EventOut(Out):
    """Recorded event. ``seq`` always increases, so the stream can be resumed after any event."""

    seq: int
    at: Utc
    kind: str
    severity: str
    text: str
    data: JsonObject

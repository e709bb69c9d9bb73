"""Base models of responses. The base models of requests are in gss.operations.requests."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from pydantic import BaseModel, ConfigDict, PlainSerializer

from gss.operations.requests import MAX_ID, Id
from gss.operations.requests import Request as In

__all__ = ["MAX_ID", "Id", "In", "Out", "ProblemOut", "Utc"]


class Out(BaseModel):
    """Response body, built from attributes of rows and records."""

    model_config = ConfigDict(from_attributes=True, json_schema_serialization_defaults_required=True)


def _iso_z(value: datetime) -> str:
    utc_time = value if value.tzinfo else value.replace(tzinfo=UTC)
    return utc_time.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


Utc = Annotated[datetime, PlainSerializer(_iso_z, return_type=str)]
"""UTC time, sent as ISO 8601 with milliseconds and Z."""


class ProblemOut(Out):
    """Error response: what happened, what was expected, what was received, what to do next, and an id that is also in
    the server's log."""

    id: str
    message: str
    expected: str = ""
    got: str = ""
    hint: str = ""

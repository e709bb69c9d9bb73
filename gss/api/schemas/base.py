"""Base models: strict validation of requests, documented responses."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, model_validator

LARGEST_ID = 2**31 - 1
"""Row ids in the database are 32-bit."""
DEEPEST = 32
"""Maximum nesting depth of a request body."""


class In(BaseModel):
    """Request body; unknown fields and implicit type conversions are rejected."""

    model_config = ConfigDict(extra="forbid", strict=True)

    @model_validator(mode="before")
    @classmethod
    def _whole_characters(cls, data: Any) -> Any:
        """Reject lone surrogates and NUL, which cannot be stored, sent or shown."""
        _check_text(data)
        return data


def _check_text(value: Any) -> None:
    """Check all text in a value. Iterative, because the client controls the nesting depth."""
    rest: list[tuple[Any, int]] = [(value, 0)]
    while rest:
        item, depth = rest.pop()
        if depth > DEEPEST:
            raise ValueError(f"nested deeper than {DEEPEST}")
        if isinstance(item, dict):
            rest += [(part, depth + 1) for pair in item.items() for part in pair]
        elif isinstance(item, list):
            rest += [(part, depth + 1) for part in item]
        elif isinstance(item, str) and ("\0" in item or any("\ud800" <= c <= "\udfff" for c in item)):
            raise ValueError("text holds NUL or half a character")


class Out(BaseModel):
    """Response body, built from attributes of rows and records."""

    model_config = ConfigDict(from_attributes=True)


def _iso_z(value: datetime) -> str:
    moment = value if value.tzinfo else value.replace(tzinfo=UTC)
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


Id = Annotated[int, Field(ge=1, le=LARGEST_ID)]
"""Row id in a request body."""
Utc = Annotated[datetime, PlainSerializer(_iso_z, return_type=str)]
"""UTC, ISO 8601 with Z, milliseconds."""


class ProblemOut(Out):
    """Error response: what happened, what was expected, what was received, what to do next, and an id that is also in
    the server's log."""

    id: str
    message: str
    expected: str = ""
    got: str = ""
    hint: str = ""

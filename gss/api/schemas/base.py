"""The base of everything that travels: strict in, documented out."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, model_validator

LARGEST_ID = 2**31 - 1
"""The database counts rows in 32 bits."""


class In(BaseModel):
    """A request body: unknown fields and silent conversions are refused."""

    model_config = ConfigDict(extra="forbid", strict=True)

    @model_validator(mode="before")
    @classmethod
    def _whole_characters(cls, data: Any) -> Any:
        """Half characters (lone surrogates) and NUL cannot be stored, sent or shown."""
        _check_text(data)
        return data


def _check_text(value: Any) -> None:
    if isinstance(value, dict):
        for name, item in value.items():
            _check_text(name)
            _check_text(item)
    elif isinstance(value, list):
        for item in value:
            _check_text(item)
    elif isinstance(value, str) and ("\0" in value or any("\ud800" <= c <= "\udfff" for c in value)):
        raise ValueError("text holds NUL or half a character")


class Out(BaseModel):
    """A response body, built from attributes of rows and records."""

    model_config = ConfigDict(from_attributes=True)


def _iso_z(value: datetime) -> str:
    moment = value if value.tzinfo else value.replace(tzinfo=UTC)
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


Id = Annotated[int, Field(ge=1, le=LARGEST_ID)]
"""A row's id in a request body."""
Utc = Annotated[datetime, PlainSerializer(_iso_z, return_type=str)]
"""UTC, ISO 8601 with Z, milliseconds."""


class ProblemOut(Out):
    """Every error: what happened, what was expected, what came, what to try, and an id that is in the server's log."""

    id: str
    message: str
    expected: str = ""
    got: str = ""
    hint: str = ""

"""Base class of request models, and conversion of requests to stored JSON."""

from __future__ import annotations

import json
import re
from typing import Annotated, Any, TypeVar
from urllib.parse import parse_qsl

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject

MAX_PATH_LENGTH = 4000
"""Maximum length of the address of a page of the console."""
MAX_ID = 2**31 - 1
"""Largest row id: row ids in the database are 32-bit integers."""
DEEPEST = 32
"""Maximum nesting depth of a request body."""
Id = Annotated[int, Field(ge=1, le=MAX_ID)]
"""Row id in a request."""
RangeValues = Annotated[list[float | int | None], Field(min_length=2, max_length=2)]
"""[low, high], null for no limit."""
ChainOptions = Annotated[
    dict[Annotated[str, Field(min_length=1, max_length=40)], Annotated[str, Field(max_length=60)]], Field(max_length=30)
]
"""Changed constants of a chain: name to value as text."""


class Request(BaseModel):
    """Base class of user requests. Fields are in user units, both in the API and in stored jobs.

    Unknown fields and implicit type conversions are rejected.
    """

    model_config = ConfigDict(extra="forbid", strict=True)

    @model_validator(mode="before")
    @classmethod
    def _whole_characters(cls, data: Any) -> Any:
        """Reject lone surrogates and NUL characters, which cannot be stored, sent or shown."""
        _check_text(data)
        return data


def _check_text(value: Any) -> None:
    """Check all text in a value. The check does not recurse, because a client can send deeply nested values."""
    pending: list[tuple[Any, int]] = [(value, 0)]
    while pending:
        item, depth = pending.pop()
        if depth > DEEPEST:
            raise ValueError(f"nested deeper than {DEEPEST}")
        if isinstance(item, dict):
            pending += [(part, depth + 1) for pair in item.items() for part in pair]
        elif isinstance(item, list):
            pending += [(part, depth + 1) for part in item]
        elif isinstance(item, str) and ("\0" in item or any("\ud800" <= c <= "\udfff" for c in item)):
            raise ValueError("text contains NUL or an incomplete character")


NOT_PAGES = ("", "api", "setup", "welcome", "units")
"""First parts of addresses outside the pages of a unit."""


PAGE = re.compile(r"/(?P<first>[a-z0-9-]+)(?:/(?!\.\.?(?:[/?]|$))[\w.~-]+)*/?(?:\?[^\\#]*)?$", re.ASCII)
"""Path of a page: its name, and segments without escapes, so that no browser changes it to another path."""


def check_page_path(path: str) -> None:
    """Raise BadInput unless the path can be the address of a page of this console within the unit, with its query."""
    page = PAGE.match(path)
    is_console_path = page is not None and page["first"] not in NOT_PAGES
    is_printable = path.isascii() and path.isprintable() and " " not in path
    if not is_console_path or len(path) > MAX_PATH_LENGTH or not is_printable:
        raise BadInput(
            "The address is not a page of the console", expected="for example /telemetry?plot=…", got=path[:80]
        )


NUMBERED_PARTS = frozenset(
    ("alarm", "contact", "frames", "id", "job", "over", "pass", "plan", "procedure", "run", "station")
)
"""Parts of a query that name rows by number."""


def names_row(path: str) -> bool:
    """True if the address of a page names a row of a unit's database: ``/frames/12`` or ``/commands?id=3``. The number of a
    star is the same for all units."""
    page, _, query = path.partition("?")
    first, *rest = page.removeprefix("/").split("/")
    in_page = first != "stars" and any(part.isdecimal() for part in rest)
    return in_page or any(name in NUMBERED_PARTS and any(map(str.isdigit, value)) for name, value in parse_qsl(query))


R = TypeVar("R", bound=Request)


def request_from(model: type[R], values: JsonObject) -> R:
    """Return the request with these values, for the command line. Raises BadInput that names the first invalid field."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        name = "".join(f", item {part + 1}" if isinstance(part, int) else f".{part}" for part in first["loc"])[1:]
        if not name:
            raise BadInput("the request is not valid", got=first["msg"].removeprefix("Value error, ")) from None
        raise BadInput(
            f"{name} is out of range",
            expected=first["msg"].removeprefix("Input should be "),
            got=str(first["input"])[:80],
        ) from None


def request_from_text(model: type[R], text: str) -> R:
    """Return the request in a JSON text. Raises BadInput."""
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, dict):
        raise BadInput("the request is not a JSON object", expected="{...}", got=text[:40])
    return request_from(model, values)


def as_stored(request: Any) -> JsonObject:
    """Return a request (a model or a dataclass) as JSON values."""
    stored: JsonObject = TypeAdapter(type(request)).dump_python(request, mode="json")
    return stored

"""JSON objects whose form only their writer and their reader know."""

from __future__ import annotations

from typing import Any

JsonObject = dict[str, Any]
"""A JSON object that this code passes on: a column of the store, a stored request or result, content of a file. A record
with known fields has a type: a frozen dataclass, a TypedDict or a pydantic model."""

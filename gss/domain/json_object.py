"""Type of JSON objects whose fields this code does not interpret."""

from __future__ import annotations

from typing import Any

JsonObject = dict[str, Any]
"""A JSON object that this code passes on without reading its fields: a column of the store, a stored request or result, or the
content of a file. Records with known fields use a frozen dataclass, a TypedDict or a pydantic model instead."""

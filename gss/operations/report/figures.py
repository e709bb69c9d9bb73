"""Formatting of numbers in reports."""

from __future__ import annotations

from typing import Any


def number(value: Any, digits: int = 4) -> str:
    """Format a number with ``digits`` significant digits and a true minus; a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, int):
        return f"{value}"
    return f"{float(value):#.{digits}g}".rstrip(".").replace("-", "\N{MINUS SIGN}")

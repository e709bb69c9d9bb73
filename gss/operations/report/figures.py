"""Figures as a reader of a report expects them."""

from __future__ import annotations

from typing import Any


def number(value: Any, digits: int = 4) -> str:
    """A figure with so many significant digits and a true minus; a dash where there is none."""
    if value is None:
        return "–"
    if isinstance(value, int):
        return f"{value}"
    return f"{float(value):#.{digits}g}".rstrip(".").replace("-", "\N{MINUS SIGN}")

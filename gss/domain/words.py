"""Counts and verb forms for messages."""

from __future__ import annotations


def counted(count: int, one: str, many: str = "") -> str:
    """Format a count with its noun: "1 frame", "12 frames". ``many``: the plural if it is not the noun with an s."""
    return f"{count} {one if count == 1 else many or one + 's'}"


def verb(count: int, one: str, many: str) -> str:
    """Return the verb form that agrees with a count: ``one`` ("is") or ``many`` ("are")."""
    return one if count == 1 else many

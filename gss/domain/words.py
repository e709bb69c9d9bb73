"""Counts and verb forms for messages."""

from __future__ import annotations


def counted(count: int, singular: str, plural: str = "") -> str:
    """Format a count with its noun: "1 frame", "12 frames". ``plural``: plural of the noun, needed only if it is irregular."""
    return f"{count} {singular if count == 1 else plural or singular + 's'}"


def verb(count: int, singular: str, plural: str) -> str:
    """Return the verb form that agrees with a count: ``singular`` ("is") or ``plural`` ("are")."""
    return singular if count == 1 else plural

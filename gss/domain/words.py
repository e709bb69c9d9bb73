"""Counts in words, as sentences for people need them."""

from __future__ import annotations


def counted(count: int, one: str, many: str = "") -> str:
    """ "1 frame", "12 frames": a count with its noun. ``many``: the plural where it is not the noun with an s."""
    return f"{count} {one if count == 1 else many or one + 's'}"


def verb(count: int, one: str, many: str) -> str:
    """The verb that goes with a count: "is" or "are"."""
    return one if count == 1 else many

"""Parses lists and ranges of numbers: ``3,5-9``."""

from __future__ import annotations

from gss.domain.errors import BadInput
from gss.operations.requests import MAX_ID

MAX_PER_RANGE = 10_000
MAX_DIGITS = 100
"""Maximum number of digits. Longer numbers are rejected without conversion."""


def ids_of(text: str) -> list[int]:
    """Return the numbers in the order of the text. Raises BadInput if the text is not a list of numbers and ranges."""
    ids: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        if not (first.isascii() and first.isdigit()) or (last and not (last.isascii() and last.isdigit())):
            raise BadInput("invalid list of frames", expected="numbers and ranges such as 3,5-9", got=text[:80])
        if max(len(first), len(last)) > MAX_DIGITS or int(last or first) > MAX_ID:
            raise BadInput("no frame has this number", expected=f"numbers up to {MAX_ID}", got=part[:80])
        low, high = int(first), int(last or first)
        if high < low or high - low >= MAX_PER_RANGE:
            raise BadInput("invalid range of frames", expected=f"low-high, at most {MAX_PER_RANGE} frames", got=part)
        ids += range(low, high + 1)
    return ids

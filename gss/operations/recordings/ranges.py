"""Parses lists and ranges of numbers: ``3,5-9``."""

from __future__ import annotations

from gss.domain.errors import BadInput
from gss.operations.requests import LARGEST_ID

MOST_IN_A_RANGE = 10_000
MOST_DIGITS = 100
"""Longer numbers are not converted at all."""


def ids_of(text: str) -> list[int]:
    """Return the numbers in the order written. Raises BadInput for anything else."""
    ids: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        if not (first.isascii() and first.isdigit()) or (last and not (last.isascii() and last.isdigit())):
            raise BadInput("invalid list of frames", expected="numbers and ranges such as 3,5-9", got=text[:80])
        if max(len(first), len(last)) > MOST_DIGITS or int(last or first) > LARGEST_ID:
            raise BadInput("no frame has this number", expected=f"numbers up to {LARGEST_ID}", got=part[:80])
        low, high = int(first), int(last or first)
        if high < low or high - low >= MOST_IN_A_RANGE:
            raise BadInput("invalid range of frames", expected=f"low-high, at most {MOST_IN_A_RANGE} frames", got=part)
        ids += range(low, high + 1)
    return ids

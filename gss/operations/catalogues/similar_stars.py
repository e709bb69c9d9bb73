"""Stars whose name differs from a text by one typing error."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gss.catalogue_tools.sources.hipparcos import load_hipparcos, other_names
from gss.catalogue_tools.sources.star_names import NamedStar, plain_name

MIN_LETTERS = 4
"""Minimum length of a text. Shorter texts differ from too many names by one letter."""


def similar_stars(text: str, limit: int) -> list[NamedStar]:
    """Return the stars that have a name with one typing error from the text, brighter stars first: "betelguese" finds
    Betelgeuse. No result is exact."""
    query = plain_name(text)
    if len(query) < MIN_LETTERS:
        return []
    rows = {row for name, row in _plain_names() if has_one_typing_error(query, name)}
    return [NamedStar(row, exact=False) for row in sorted(rows)[:limit]]


def has_one_typing_error(text: str, name: str) -> bool:
    """True if one letter of the text is missing, additional, wrong, or exchanged with the next letter."""
    if text == name or abs(len(text) - len(name)) > 1:
        return False
    same = next((i for i, (x, y) in enumerate(zip(text, name, strict=False)) if x != y), min(len(text), len(name)))
    a, b = text[same:], name[same:]
    return a[1:] == b[1:] or a[1:] == b or a == b[1:] or (a[:2] == b[1::-1] and a[2:] == b[2:])


@lru_cache(maxsize=1)
def _plain_names() -> tuple[tuple[str, int], ...]:
    """Every plain name with the row of its star in ``load_hipparcos()``, whose rows are sorted by magnitude."""
    stars, others = load_hipparcos(), other_names()
    rows = np.flatnonzero(np.isin(stars.hip, np.fromiter(stars.names, np.int64)))
    hips = {int(stars.hip[row]): int(row) for row in rows}
    return tuple((plain_name(n), row) for hip, row in hips.items() for n in (stars.names[hip], *others.get(hip, ())))

"""Search for stars of the Hipparcos catalogue by number and by name."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gss.catalogue_tools.sources.hipparcos import load_hipparcos

_NUMBER = re.compile(r"(?:hip\s*)?(\d{1,7})")
_MIN_INNER_LETTERS = 3
"""Minimum length of a text that is also searched inside words."""
_GREEK = {
    ord(letter): unicodedata.name(letter).rsplit(" ", 1)[1].casefold().replace("lamda", "lambda")
    for letter in "αβγδεζηθικλμνξοπρστυφχψω"
}


@dataclass(frozen=True)
class NamedStar:
    """Star that matches a search. ``row``: row in ``load_hipparcos()``. ``exact``: true if the number or the whole name
    is equal to the text."""

    row: int
    exact: bool


def find_stars(text: str, limit: int) -> list[NamedStar]:
    """Return the stars that match a text, exact matches first, then names that start with the text, then brighter
    stars.

    A text is a Hipparcos number ("27989", "HIP 27989") or part of a proper, Bayer, Flamsteed or variable-star name.
    Upper case, Greek letters and their English names, and superscripts do not matter: "zeta psc" finds ζ Psc.
    """
    query = plain_name(text)
    if not query:
        return []
    number = _NUMBER.fullmatch(query)
    if number is not None:
        return [NamedStar(int(row), exact=True) for row in np.flatnonzero(load_hipparcos().hip == int(number[1]))]
    ranked = sorted((rank, row) for name, row in _names() if (rank := _rank(query, name)) is not None)
    return [NamedStar(row, exact=rank == 0) for rank, row in ranked[:limit]]


def named_stars() -> int:
    """Return the number of stars that have a name."""
    return len(_names())


def plain_name(text: str) -> str:
    """Return a name in lower case with Greek letters as English words and superscripts as digits."""
    return " ".join(unicodedata.normalize("NFKC", text).casefold().translate(_GREEK).split())


def _rank(query: str, name: str) -> int | None:
    """Return 0 for the whole name, 1 for its start, 2 for the start of a word, 3 for another part, None if the name does
    not contain the text."""
    if name == query:
        return 0
    if name.startswith(query):
        return 1
    if f" {query}" in name:
        return 2
    return 3 if len(query) >= _MIN_INNER_LETTERS and query in name else None


@lru_cache(maxsize=1)
def _names() -> tuple[tuple[str, int], ...]:
    """Plain name and row of each star with a name."""
    stars = load_hipparcos()
    named_rows = np.flatnonzero(np.isin(stars.hip, np.fromiter(stars.names, np.int64)))
    return tuple((plain_name(stars.names[int(stars.hip[row])]), int(row)) for row in named_rows)

"""Search for stars of the Hipparcos catalogue by number and by name."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gss.catalogue_tools.sources.hipparcos import load_hipparcos, other_names

_NUMBER = re.compile(r"(?:hip\s*)?(\d{1,7})")
_SUPERSCRIPTS = re.compile("[¹²³⁴⁵⁶⁷⁸⁹]+")
"""Number of a Bayer name, as in α¹ Cen."""
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
    Upper case, Greek letters and their English names, and superscripts do not matter: "zeta psc" finds ζ Psc, and
    "alpha cen" α¹ and α² Cen.
    """
    query = plain_name(text)
    if not query:
        return []
    number = _NUMBER.fullmatch(query)
    if number is not None:
        return [NamedStar(int(row), exact=True) for row in np.flatnonzero(load_hipparcos().hip == int(number[1]))]
    ranked: dict[int, int] = {}
    for name, row in _names():
        rank = _rank(query, name)
        if rank is not None:
            ranked[row] = min(rank, ranked.get(row, rank))
    order = sorted(ranked, key=lambda row: (ranked[row], row))
    return [NamedStar(row, exact=ranked[row] == 0) for row in order[:limit]]


def named_stars() -> int:
    """Return the number of stars that have a name."""
    return len(load_hipparcos().names)


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
    """Every plain name with the row of its star. A Bayer name with a number (α¹ Cen) is
    listed twice, with and without its number."""
    stars, others = load_hipparcos(), other_names()
    found: dict[tuple[str, int], None] = {}
    for row in np.flatnonzero(np.isin(stars.hip, np.fromiter(stars.names, np.int64))):
        hip = int(stars.hip[row])
        for name in (stars.names[hip], *others.get(hip, ())):
            for form in (name, _SUPERSCRIPTS.sub("", name)):
                found[plain_name(form), int(row)] = None
    return tuple(found)

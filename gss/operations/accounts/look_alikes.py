"""Checks of user names that can be mistaken for others: names that mix scripts, and names that look like another user's name."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

from gss.domain.errors import BadInput, Conflict
from gss.store.accounts import name_key

SCRIPTS = ("LATIN", "GREEK", "CYRILLIC", "ARMENIAN", "CHEROKEE")
"""Scripts that share letter shapes (Unicode UTS #39)."""
SAME_SHAPE = str.maketrans(
    "аеорсухіјѕһԁԛԝвкмнтαοριυντκχβε01|",
    "aeopcyxijshdqwbkmhtaopiuvtkxbeoll",
)
"""Cyrillic and Greek letters and digits, mapped to the Latin letter of the same shape. Selected from confusables.txt of UTS #39."""


def check_script(name: str) -> None:
    """Raise BadInput if a name mixes scripts that share letter shapes."""
    scripts = {unicodedata.name(c, "").partition(" ")[0] for c in name if c.isalpha()} & set(SCRIPTS)
    if len(scripts) > 1:
        raise BadInput(
            "this name mixes scripts", expected="letters of one script", got=", ".join(sorted(scripts)).capitalize()
        )


def check_unlike(name: str, others: Iterable[str]) -> None:
    """Raise Conflict if a name looks like one of ``others`` but is not the same name."""
    for other in others:
        if name_key(other) != name_key(name) and _shape(other) == _shape(name):
            raise Conflict("this name looks like another user's", got=name, hint=f"{other} exists; choose another name")


def _shape(name: str) -> str:
    return name_key(name.replace("I", "l")).translate(SAME_SHAPE).replace("rn", "m").replace("vv", "w").replace(" ", "")

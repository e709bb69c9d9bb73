"""What is wrong with the data, and what to do about it: a value beside the result, not an exception."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Advice:
    """One finding. ``code`` is stable and short ("one-part"), ``text`` says what was found, ``hint`` what to do;
    ``severe``: the result should not be used as it is."""

    code: str
    text: str
    hint: str
    severe: bool = False

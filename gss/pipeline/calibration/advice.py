"""Warnings about the data with suggested actions, returned with a result instead of raised as exceptions."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Advice:
    """One warning. ``code``: stable and short ("one-part"), ``text``: the problem, ``hint``: what to do;
    ``severe``: True if the result should not be used as it is."""

    code: str
    text: str
    hint: str
    severe: bool = False

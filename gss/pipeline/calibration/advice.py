"""Warnings about the data, with suggested actions. They are returned with a result, not raised as exceptions."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Advice:
    """Warning about the data. ``code``: stable short identifier ("one-part"); ``text``: the problem; ``hint``:
    suggested action; ``severe``: True if the result should not be used unchanged."""

    code: str
    text: str
    hint: str
    severe: bool = False

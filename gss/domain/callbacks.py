"""Callbacks for callers that do not need progress reports or cancellation."""

from __future__ import annotations


def no_progress(*_: object) -> None:
    """Ignore a progress report."""


def never() -> bool:
    """Return False, which means that the work is not cancelled."""
    return False

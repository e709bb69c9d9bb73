"""Callbacks for callers that need no progress and cannot cancel."""

from __future__ import annotations


def no_progress(*_: object) -> None:
    """Ignore a progress report."""


def never() -> bool:
    """Return False: the work is not to be cancelled."""
    return False

"""Exception for rejected commands and transfers."""

from __future__ import annotations


class Rejection(Exception):
    """Raised when a command or transfer cannot be executed. ``reason``: name in the dictionary; ``detail``: a
    sentence."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason, self.detail = reason, detail

"""Exception for rejected commands and transfers."""

from __future__ import annotations


class Rejection(Exception):
    """A command or transfer cannot be executed: the dictionary's reason and a sentence."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason, self.detail = reason, detail

"""Exceptions that state the expected value, the received value and a hint. "No solution" is not an error; see ``Outcome``."""

from __future__ import annotations

import re

PLAIN_WORD = re.compile(r"[a-z][a-z'’-]*(?=[ ,;]|$)")
"""Pattern of a first word that can be capitalised. Names of fields, files and commands do not match and remain
unchanged."""


class GssError(Exception):
    """Base class of expected failures. ``expected``, ``got`` and ``hint`` are shown on the page and in the terminal."""

    def __init__(self, message: str, *, expected: str = "", got: str = "", hint: str = "") -> None:
        super().__init__(message)
        self.message, self.expected, self.got, self.hint = message, expected, got, hint

    def __str__(self) -> str:
        parts = [self.message]
        if self.expected:
            parts.append(f"expected {self.expected}")
        if self.got:
            parts.append(f"got {self.got}")
        text = "; ".join(parts)
        return f"{text}. Try: {self.hint}" if self.hint else text

    def sentences(self) -> str:
        """Return the complete message as sentences: what happened, what was expected and received, what to do next."""
        facts = [f"{name} {text}" for name, text in (("expected", self.expected), ("got", self.got)) if text]
        return " ".join(as_sentence(text) for text in (self.message, "; ".join(facts), self.hint) if text)


def as_sentence(text: str) -> str:
    """Return a message as a sentence with a capital letter and a period. Return "" for "".

    Messages in exceptions begin in lower case and have no period, because other messages quote them. They are converted to
    sentences in HTTP responses and in the terminal.
    """
    first = PLAIN_WORD.match(text)
    start = text[:1].upper() + text[1:] if first else text
    return start if not start or start.endswith((".", "!", "?", "…")) else f"{start}."


class BadInput(GssError):
    """The caller's input is not valid. Nothing was changed."""


class TooCostly(BadInput):
    """Reading a file exceeded the limit for memory, processor time or elapsed time."""


class NotFound(GssError):
    """The requested item does not exist."""


class Conflict(GssError):
    """The request is valid but not allowed in the current state."""


class LinkDown(GssError):
    """The device cannot be reached."""


class StoreDown(GssError):
    """The store cannot be read or written, for example because the disk is full or the file is locked or missing."""


class CorruptData(GssError):
    """Stored or received bytes fail their integrity check."""


class NotSignedIn(GssError):
    """The request is not authenticated."""


class NotPermitted(GssError):
    """The user's role does not permit this action."""


class RateLimited(GssError):
    """Rate limit exceeded. Retry after ``retry_after_s``."""

    def __init__(
        self, message: str, *, expected: str = "", got: str = "", hint: str = "", retry_after_s: float = 0.0
    ) -> None:
        super().__init__(message, expected=expected, got=got, hint=hint)
        self.retry_after_s = retry_after_s


class Busy(GssError):
    """All workers for this kind of request are busy. Retry after ``retry_after_s``."""

    def __init__(
        self, message: str, *, expected: str = "", got: str = "", hint: str = "", retry_after_s: float = 0.0
    ) -> None:
        super().__init__(message, expected=expected, got=got, hint=hint)
        self.retry_after_s = retry_after_s

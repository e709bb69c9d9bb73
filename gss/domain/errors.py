"""What can go wrong, with what was expected, what came and what to try. "No solution" is not an error: see ``Outcome``."""

from __future__ import annotations


class GssError(Exception):
    """A broken contract or a broken world. ``expected``, ``got`` and ``hint`` end up on the page and on the terminal."""

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


class BadInput(GssError):
    """The caller gave something that cannot be used; nothing was changed."""


class TooCostly(BadInput):
    """A file reached a limit of memory, processor time or wall time while it was read."""


class NotFound(GssError):
    """The thing asked for does not exist."""


class Conflict(GssError):
    """The request is fine but not in the present state."""


class LinkDown(GssError):
    """The device cannot be reached."""


class StoreDown(GssError):
    """The store cannot be read or written now: disk full, locked, gone."""


class CorruptData(GssError):
    """Stored or received bytes fail their own check."""


class NotSignedIn(GssError):
    """Nobody has proved who they are."""


class NotPermitted(GssError):
    """Whoever asks has not the role for it."""


class TooOften(GssError):
    """Too many tries; the next one is heard after ``retry_after_s``."""

    def __init__(
        self, message: str, *, expected: str = "", got: str = "", hint: str = "", retry_after_s: float = 0.0
    ) -> None:
        super().__init__(message, expected=expected, got=got, hint=hint)
        self.retry_after_s = retry_after_s


class Busy(GssError):
    """All workers for this kind of request are in use; retry after ``retry_after_s``."""

    def __init__(
        self, message: str, *, expected: str = "", got: str = "", hint: str = "", retry_after_s: float = 0.0
    ) -> None:
        super().__init__(message, expected=expected, got=got, hint=hint)
        self.retry_after_s = retry_after_s

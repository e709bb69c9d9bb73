"""What a fuzz target is, and the check that it makes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Target:
    """One parser. ``text``: True if the input is also mutated as text. ``max_bytes``: maximum input length; longer
    inputs reach no additional code."""

    fuzz_one: Callable[[bytes], None]
    text: bool = False
    max_bytes: int = 1 << 16


def require(condition: bool, problem: str) -> None:
    """Raise AssertionError with the problem unless the condition holds."""
    if not condition:
        raise AssertionError(problem)

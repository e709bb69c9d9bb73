"""What happened on the way: intermediates by name and, where the caller lends a clock, seconds per stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

Clock = Callable[[], float]


@dataclass
class Trace:
    """Collects while a chain runs. Without a clock there are no times and a run leaves nothing that differs from the next."""

    clock: Clock | None = None
    timing_s: dict[str, float] = field(default_factory=dict)
    kept: dict[str, object] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times what is inside; a stage entered twice adds up."""
        if self.clock is None:
            yield
            return
        start_s = self.clock()
        try:
            yield
        finally:
            self.timing_s[name] = self.timing_s.get(name, 0.0) + self.clock() - start_s

    def keep(self, name: str, value: object) -> None:
        """Remembers an intermediate; the last of a name stays."""
        self.kept[name] = value

"""Trace of a chain's run: intermediate results by name and, if the caller supplies a clock, seconds per stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

Clock = Callable[[], float]


@dataclass
class Trace:
    """Recorder of intermediate results of a chain. Without a clock, no times are recorded and repeated runs give
    identical traces."""

    clock: Clock | None = None
    timing_s: dict[str, float] = field(default_factory=dict)
    kept: dict[str, object] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the time of the enclosed block. If a stage is entered more than once, its times are added."""
        if self.clock is None:
            yield
            return
        start_s = self.clock()
        try:
            yield
        finally:
            self.timing_s[name] = self.timing_s.get(name, 0.0) + self.clock() - start_s

    def keep(self, name: str, value: object) -> None:
        """Store an intermediate result. It replaces an earlier result with the same name."""
        self.kept[name] = value

"""Trace of a chain's run: intermediate results by name and, if the caller supplies a clock, seconds per stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field

Clock = Callable[[], float]


@dataclass
class Trace:
    """Recorder of intermediate results of a chain. Without a clock, no times are recorded and repeated runs give
    identical traces."""

    clock: Clock | None = None
    timing_s: dict[str, float] = field(default_factory=dict)
    kept: dict[str, object] = field(default_factory=dict)

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Return a context manager for one block, which measures its time if there is a clock. The times of blocks with the
        same name are added."""
        return nullcontext() if self.clock is None else self._measured(name, self.clock)

    @contextmanager
    def _measured(self, name: str, clock: Clock) -> Iterator[None]:
        start_s = clock()
        try:
            yield
        finally:
            self.timing_s[name] = self.timing_s.get(name, 0.0) + clock() - start_s

    def keep(self, name: str, value: object) -> None:
        """Store an intermediate result. It replaces an earlier result with the same name."""
        self.kept[name] = value

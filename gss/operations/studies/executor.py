"""Where long work runs: in this thread, on worker processes of this machine, or on a Dask cluster by URL. The same work on the
same items gives the same results in the same order on any of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as Late
from concurrent.futures.process import BrokenProcessPool
from typing import Protocol, TypeVar

from gss.domain.errors import GssError
from gss.operations.studies.warm_pool import IDLE_S, WarmPool

Item = TypeVar("Item")
Result = TypeVar("Result")
Told = Callable[[float], None]
"""Tells the share of an item that is done, 0 … 1."""
Work = Callable[[Item, Told], Result]
"""A function of a module (never a closure), for it is named to other processes."""
Waiting = Callable[[float], None]
"""Called with the share of the oldest open item that is done, a few times a second; what it raises ends the run."""

AHEAD = 3
"""Items per worker that wait in line: workers are never idle, and a cancelled run ends at once."""
LOOK_S = 0.25
MOST_DEATHS = 3


class Executor(Protocol):
    """Runs work on items."""

    @property
    def workers(self) -> int:
        """How many items are worked on at once."""

    def in_order(
        self, work: Work[Item, Result], items: Iterable[Item], waiting: Waiting | None = None
    ) -> Generator[Result, None, None]:
        """The result of each item, once, in the order of the items, whichever worker dies meanwhile. What the work raises is
        raised here. Closing the iterator ends what is under way. GssError where workers die again and again."""

    def stop(self) -> None:
        """End the workers that are ours."""


class HereExecutor:
    """One item after the other in the thread that asks: the finest progress, and cancelled in the middle of an item."""

    workers = 1

    def in_order(
        self, work: Work[Item, Result], items: Iterable[Item], waiting: Waiting | None = None
    ) -> Generator[Result, None, None]:
        """As :class:`Executor` says."""
        for item in items:
            yield work(item, waiting or _silent)

    def stop(self) -> None:
        """Nothing is ours."""


class LocalExecutor:
    """Worker processes of this machine, kept warm between runs. A run survives the death of workers."""

    def __init__(self, workers: int, idle_s: float = IDLE_S) -> None:
        self._pool = WarmPool(workers, idle_s)

    @property
    def workers(self) -> int:
        """As :class:`Executor` says."""
        return self._pool.workers

    def stop(self) -> None:
        """End the processes; a later run starts new ones."""
        self._pool.stop()

    def in_order(
        self, work: Work[Item, Result], items: Iterable[Item], waiting: Waiting | None = None
    ) -> Generator[Result, None, None]:
        """As :class:`Executor` says. A death costs the work on the items under way, not their results: they are done again."""
        rest, open_items, deaths = iter(items), deque[Item](), 0
        while True:
            try:
                with self._pool.borrowed() as pool:
                    running = deque(pool.submit(work, item, _silent) for item in open_items)
                    while True:
                        while len(running) < AHEAD * self.workers and (more := next(rest, _END)) is not _END:
                            open_items.append(more)  # type: ignore[arg-type]  # it is not _END, which mypy does not see
                            running.append(pool.submit(work, open_items[-1], _silent))
                        if not running:
                            return
                        result = _result(running[0], waiting)
                        running.popleft()
                        open_items.popleft()
                        yield result
            except BrokenProcessPool as error:
                deaths += 1
                if deaths > MOST_DEATHS:
                    raise GssError(
                        "worker processes died again and again",
                        got=f"{deaths} deaths in one run; {error}",
                        hint="look at the machine's memory; what was done is kept, and a new start does the rest",
                    ) from error


_END = object()


def _result(future: Future[Result], waiting: Waiting | None) -> Result:
    while True:
        try:
            return future.result(LOOK_S if waiting else None)
        except Late:
            if future.done():  # the work itself raised it
                raise
            if waiting is not None:
                waiting(0.0)


def _silent(_share: float) -> None:
    """For work whose progress within an item nobody follows."""

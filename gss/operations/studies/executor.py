"""Executors for long work: in the calling thread, on worker processes of this host, or on a Dask cluster. The same work on
the same items gives the same results in the same order on each of them."""

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
ShareCallback = Callable[[float], None]
"""Reports the completed share of an item, 0 … 1."""
Work = Callable[[Item, ShareCallback], Result]
"""A module-level function (not a closure), because other processes import it by name."""
Waiting = Callable[[float], None]
"""Called a few times a second with the completed share of the oldest open item; an exception from it ends the run."""

AHEAD = 3
"""Queued items per worker: enough to keep workers busy, few enough that a cancelled run ends at once."""
LOOK_S = 0.25
MAX_DEATHS = 3


class Executor(Protocol):
    """Runs work on items."""

    @property
    def workers(self) -> int:
        """Number of items processed concurrently."""

    def in_order(
        self, work: Work[Item, Result], items: Iterable[Item], waiting: Waiting | None = None
    ) -> Generator[Result, None, None]:
        """Yield the result of each item, once, in the order of the items, even if workers die. Exceptions from the work are
        raised here. Closing the iterator stops work in progress. Raises GssError if workers die repeatedly."""

    def stop(self) -> None:
        """Stop the workers started by this executor."""


class HereExecutor:
    """Runs one item after the other in the calling thread, with the finest progress; can be cancelled within an item."""

    workers = 1

    def in_order(
        self, work: Work[Item, Result], items: Iterable[Item], waiting: Waiting | None = None
    ) -> Generator[Result, None, None]:
        """See :class:`Executor`."""
        for item in items:
            yield work(item, waiting or _silent)

    def stop(self) -> None:
        """Nothing to stop."""


class LocalExecutor:
    """Worker processes of this host, kept warm between runs. A run survives the death of workers."""

    def __init__(self, workers: int, idle_s: float = IDLE_S) -> None:
        self._pool = WarmPool(workers, idle_s)

    @property
    def workers(self) -> int:
        """See :class:`Executor`."""
        return self._pool.workers

    def stop(self) -> None:
        """Stop the processes; a later run starts new ones."""
        self._pool.stop()

    def in_order(
        self, work: Work[Item, Result], items: Iterable[Item], waiting: Waiting | None = None
    ) -> Generator[Result, None, None]:
        """See :class:`Executor`. If a worker dies, only its in-progress and queued items are rerun; results already returned
        are kept."""
        remaining, open_items, deaths = iter(items), deque[Item](), 0
        while True:
            try:
                with self._pool.borrowed() as pool:
                    running = deque(pool.submit(work, item, _silent) for item in open_items)
                    while True:
                        while len(running) < AHEAD * self.workers and (next_item := next(remaining, _END)) is not _END:
                            open_items.append(next_item)  # type: ignore[arg-type]  # it is not _END, which mypy does not see
                            running.append(pool.submit(work, open_items[-1], _silent))
                        if not running:
                            return
                        result = _result(running[0], waiting)
                        running.popleft()
                        open_items.popleft()
                        yield result
            except BrokenProcessPool as error:
                deaths += 1
                if deaths > MAX_DEATHS:
                    raise GssError(
                        "worker processes crashed repeatedly",
                        got=f"{deaths} crashes in one run; {error}",
                        hint="check the memory of this machine; finished work is kept, a new start continues",
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
    """Ignore the progress within an item."""

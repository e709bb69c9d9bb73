"""Executors for long work in the calling thread, in worker processes of this host, or on a Dask cluster. The results
and their order do not depend on the executor."""

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
"""Function that reports the completed share of an item, 0 … 1."""
Work = Callable[[Item, ShareCallback], Result]
"""Function that processes an item. It must be a module-level function, because other processes import it by name."""
Waiting = Callable[[float], None]
"""Function called a few times a second with the completed share of the oldest open item. It can raise an exception to
end the run."""

AHEAD = 3
"""Number of queued items per worker. It is large enough to keep the workers busy, and small enough for a cancelled run
to end quickly."""
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
        """Yield the result of each item once, in the order of the items, even if workers die. Exceptions of the work
        are raised here. Closing the iterator stops work in progress. Raises GssError if workers die repeatedly."""

    def stop(self) -> None:
        """Stop the workers started by this executor."""


class HereExecutor:
    """Runs the items one after the other in the calling thread. Progress is reported within items, and a run can be
    cancelled within an item."""

    workers = 1

    def in_order(
        self, work: Work[Item, Result], items: Iterable[Item], waiting: Waiting | None = None
    ) -> Generator[Result, None, None]:
        """See :class:`Executor`."""
        for item in items:
            yield work(item, waiting or _ignore_share)

    def stop(self) -> None:
        """Do nothing, because there are no workers."""


class LocalExecutor:
    """Runs the items in worker processes of this host, which stay alive between runs. A run continues if workers
    die."""

    def __init__(self, workers: int, idle_s: float = IDLE_S) -> None:
        self._pool = WarmPool(workers, idle_s)

    @property
    def workers(self) -> int:
        """See :class:`Executor`."""
        return self._pool.workers

    def stop(self) -> None:
        """Stop the processes. A later run starts new processes."""
        self._pool.stop()

    def in_order(
        self, work: Work[Item, Result], items: Iterable[Item], waiting: Waiting | None = None
    ) -> Generator[Result, None, None]:
        """See :class:`Executor`. If a worker dies, only items in progress and queued items are rerun; returned results
        are kept."""
        remaining, open_items, deaths = iter(items), deque[Item](), 0
        while True:
            try:
                with self._pool.borrowed() as pool:
                    running = deque(pool.submit(work, item, _ignore_share) for item in open_items)
                    while True:
                        while len(running) < AHEAD * self.workers and (next_item := next(remaining, _END)) is not _END:
                            open_items.append(next_item)  # type: ignore[arg-type]  # mypy does not detect that it is not _END
                            running.append(pool.submit(work, open_items[-1], _ignore_share))
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
                        hint="check the memory of this machine, then start the job again; finished work is kept",
                    ) from error


_END = object()


def _result(future: Future[Result], waiting: Waiting | None) -> Result:
    while True:
        try:
            return future.result(LOOK_S if waiting else None)
        except Late:
            if future.done():  # the work raised this error, or has just ended
                return future.result()
            if waiting is not None:
                waiting(0.0)


def _ignore_share(_share: float) -> None:
    """Ignore the progress within an item."""

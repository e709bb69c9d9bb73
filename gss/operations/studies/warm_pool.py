"""A pool of worker processes that stay alive for some time after a job, so that the next job does not have to start
processes."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.context import ForkServerContext

from gss import garbage

IDLE_S = 300.0
PRELOADED = ("gss.operations.studies.reprocess_worker", "gss.operations.studies.list_runs")
"""Modules that are imported once, in the process from which workers are forked. Importing them in each worker would
take 3 s of processor time per worker."""


class WarmPool:
    """Pool of at most ``workers`` processes, which end ``idle_s`` seconds after the last job or when :meth:`stop` is
    called."""

    def __init__(self, workers: int, idle_s: float = IDLE_S) -> None:
        self._workers, self._idle_s = workers, idle_s
        self._lock = threading.Lock()
        self._pool: ProcessPoolExecutor | None = None
        self._timer: threading.Timer | None = None
        self._users = 0

    @property
    def workers(self) -> int:
        """Maximum number of processes."""
        return self._workers

    @contextmanager
    def borrowed(self) -> Iterator[ProcessPoolExecutor]:
        """Provide the processes for one job. If the job raises an exception, the processes end, because one of the
        processes can have died, or can still be running work that is no longer needed."""
        with self._lock:
            self._stop_timer()
            if self._pool is None:
                self._pool = ProcessPoolExecutor(self._workers, _fork_server(), _begin_worker)
            pool, self._users = self._pool, self._users + 1
        try:
            yield pool
        # Includes the exceptions raised when the caller closes its generator or the job is cancelled.
        except BaseException:
            self._end(pool)
            raise
        finally:
            with self._lock:
                self._users -= 1
                if self._users == 0 and self._pool is not None:
                    self._timer = threading.Timer(self._idle_s, self._end_idle)
                    self._timer.daemon = True
                    self._timer.start()

    def stop(self) -> None:
        """End the processes. A later job starts new processes."""
        with self._lock:
            self._stop_timer()
            pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=True, cancel_futures=True)

    def _end(self, pool: ProcessPoolExecutor) -> None:
        with self._lock:
            if self._pool is pool:
                self._pool = None
        pool.shutdown(wait=True, cancel_futures=True)

    def _end_idle(self) -> None:
        with self._lock:
            if self._users:
                return
            pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=True, cancel_futures=True)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _begin_worker() -> None:
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    garbage.collect_as_usual()


def _end_with_parent() -> None:
    """End this process when its parent ends for any reason, because it would wait for work forever. The fork server ends
    after its last worker."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _fork_server() -> ForkServerContext:
    """Return a context that forks workers from a process without threads. A fork of the server process could copy a
    lock that another thread has acquired."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(PRELOADED))
    return context

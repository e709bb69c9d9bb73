"""A pool of worker processes that stay alive for a while after a job, so that the next one need not start new ones."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.context import ForkServerContext

IDLE_S = 300.0
PRELOADED = ("gss.operations.studies.reprocess_worker", "gss.operations.studies.list_runs")
"""Modules that the process from which workers are forked imports once. A new Python process would need 3 s of processor
time for them per worker."""


class WarmPool:
    """At most ``workers`` processes, ended ``idle_s`` after the last job, or by :meth:`stop`."""

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
        """Provide the processes for one job. If it raises, they are ended, because one may have died or still run abandoned
        work."""
        with self._lock:
            self._quiet()
            if self._pool is None:
                self._pool = ProcessPoolExecutor(self._workers, _fork_server())
            pool, self._users = self._pool, self._users + 1
        try:
            yield pool
        except BaseException:  # also when the generator above is closed or the job is cancelled
            self._drop(pool)
            raise
        finally:
            with self._lock:
                self._users -= 1
                if self._users == 0 and self._pool is not None:
                    self._timer = threading.Timer(self._idle_s, self._end_idle)
                    self._timer.daemon = True
                    self._timer.start()

    def stop(self) -> None:
        """End the processes; a later job starts new ones."""
        with self._lock:
            self._quiet()
            pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=True, cancel_futures=True)

    def _drop(self, pool: ProcessPoolExecutor) -> None:
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

    def _quiet(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _fork_server() -> ForkServerContext:
    """Fork from a process without threads, because a fork of this one could copy a lock that another thread holds."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(PRELOADED))
    return context

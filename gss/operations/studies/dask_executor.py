"""Runs long work on a Dask cluster. If a worker dies, the scheduler reruns its work on another worker. Even then, each
result is used only once."""

from __future__ import annotations

import threading
import time
import uuid
from collections import defaultdict, deque
from collections.abc import Callable, Generator, Iterable
from functools import partial
from typing import Any

import gss
from gss.domain.errors import BadInput, Conflict, GssError, StoreDown
from gss.operations.studies.executor import (
    AHEAD,
    LOOK_S,
    Executor,
    Item,
    LocalExecutor,
    Result,
    ShareCallback,
    Waiting,
    Work,
)

CONNECT_S = 10.0
NO_WORKER_S = 60.0
"""Time in seconds without a worker in the cluster after which a run fails."""
REPORT_EVERY_S = 0.1


class DaskExecutor:
    """Client of an external cluster. ``url``: ``tcp://host:port`` of the scheduler, or ``tls://`` with the TLS settings
    of Dask.

    Scheduler and workers unpickle received data, so they must be on an isolated network. The workers must run the same
    version of the program and access the blobs by the same URL.
    """

    def __init__(self, url: str, no_worker_s: float = NO_WORKER_S, connect_s: float = CONNECT_S) -> None:
        self._url, self._no_worker_s, self._connect_s = url, no_worker_s, connect_s
        self._lock = threading.Lock()
        self._client: Any = None

    @property
    def workers(self) -> int:
        """Current number of threads of all workers; 0 without workers or scheduler."""
        client = self._client
        try:
            return sum(client.nthreads().values()) if client is not None else 0
        except OSError:  # without a scheduler, the code that waits for results reports the error
            return 0

    def stop(self) -> None:
        """Disconnect from the cluster. Its workers continue to run."""
        with self._lock:
            client, self._client = self._client, None
        if client is not None:
            client.close()

    def in_order(
        self, work: Work[Item, Result], items: Iterable[Item], waiting: Waiting | None = None
    ) -> Generator[Result, None, None]:
        """See :class:`Executor`."""
        client, remaining, run = self._connected(), iter(items), f"gss-{uuid.uuid4().hex[:12]}"
        running: deque[Any] = deque()
        shares: dict[int, float] = defaultdict(float)
        submitted = collected = 0
        client.subscribe_topic(run, lambda event: shares.update([event[1]]))
        try:
            while True:
                max_queued = AHEAD * max(1, self.workers)
                while len(running) < max_queued and (item := next(remaining, _END)) is not _END:
                    # Each item has a unique key. Equal items therefore give separate results, and results of another
                    # run are never used.
                    key = f"{run}-{submitted}"
                    running.append(
                        client.submit(_on_worker, gss.__version__, work, item, run, submitted, key=key, pure=False)
                    )
                    submitted += 1
                if not running:
                    return
                result: Result = self._result(running[0], partial(shares.__getitem__, collected), waiting)
                running.popleft()
                shares.pop(collected, None)
                collected += 1
                yield result
        finally:
            client.unsubscribe_topic(run)
            for future in running:
                future.cancel()

    def _connected(self) -> Any:
        try:
            from distributed import Client
        except ImportError:
            raise BadInput(
                "a cluster is configured, but Dask is not installed", hint="run pip install 'gss-startracker[cluster]'"
            ) from None
        with self._lock:
            if self._client is None or self._client.status != "running":
                try:
                    self._client = Client(self._url, timeout=self._connect_s, set_as_default=False, name="gss")
                except (OSError, ValueError, TimeoutError) as error:
                    raise StoreDown(
                        "the cluster cannot be reached",
                        expected=f"a Dask scheduler at {self._url}",
                        got=f"{type(error).__name__}: {error}"[:200],
                        hint="start dask scheduler there, or clear GSS_CLUSTER to use this machine",
                    ) from None
            return self._client

    def _result(self, future: Any, share: Callable[[], float], waiting: Waiting | None) -> Any:
        """Return the result of a future. While waiting, check that the cluster has workers."""
        from distributed import KilledWorker
        from distributed import TimeoutError as Late
        from distributed.client import FutureCancelledError

        without_worker_s, last_s = 0.0, time.monotonic()
        while True:
            finished = future.done()
            try:
                return future.result(timeout=LOOK_S)
            except Late:
                if finished:  # the work raised this error
                    raise
            except KilledWorker as error:
                raise GssError(
                    "a work item crashed every worker that ran it",
                    got=str(error)[:200],
                    hint="check memory and logs of the workers, then start the job again; finished work is kept",
                ) from None
            except FutureCancelledError as error:
                raise StoreDown(
                    "the connection to the cluster was lost",
                    got=str(error)[:200],
                    hint="restart its scheduler, then start the job again; finished work is kept",
                ) from None
            now_s = time.monotonic()
            without_worker_s = 0.0 if self.workers else without_worker_s + now_s - last_s
            last_s = now_s
            if without_worker_s > self._no_worker_s:
                raise StoreDown(
                    "the cluster has no worker",
                    expected=f"at least one worker within {self._no_worker_s:g} s",
                    hint=f"start a worker: dask worker {self._url} --nthreads 1",
                )
            if waiting is not None:
                waiting(share())


_END = object()


def _on_worker(version: str, work: Work[Any, Any], item: Any, run: str, number: int) -> Any:
    """Run one item on a worker. Raises Conflict if the worker has another version of the program."""
    if gss.__version__ != version:
        raise Conflict(
            "a worker of the cluster runs another version of GSS",
            expected=version,
            got=gss.__version__,
            hint="install the server's version on all workers",
        )
    return work(item, _share_reporter(run, number))


def _share_reporter(run: str, number: int) -> ShareCallback:
    from distributed import get_worker

    worker, last_s = get_worker(), time.monotonic()

    def report_share(share: float) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if now_s - last_s > REPORT_EVERY_S:
            last_s = now_s
            worker.log_event(run, (number, float(share)))

    return report_share


def make_executor(cluster_url: str, workers: int) -> Executor:
    """Return an executor for the cluster if a URL is given, otherwise for local processes."""
    return DaskExecutor(cluster_url) if cluster_url else LocalExecutor(workers)

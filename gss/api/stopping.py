"""Server shutdown: graceful if work in progress ends in time, forced after a time limit."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from types import FrameType

import uvicorn

log = logging.getLogger("gss.server")
STOP_WITHIN_S = 4.5
"""Seconds from the signal to the forced end. Stored data survive kill -9, so a forced end does not lose acknowledged
data."""


def print_stopping() -> None:
    """Print immediately that the signal was received. The text is written to the file descriptor, because the signal
    can interrupt a write to Python's streams."""
    _print("\nstopping …\n")


def end_in_time(seconds: float = STOP_WITHIN_S) -> None:
    """End the process after ``seconds`` even if threads are still computing; log the names of these threads and kill
    child processes."""
    timer = threading.Timer(seconds, _end)
    timer.daemon = True
    timer.start()


def begin_stop(announce: Callable[[], None]) -> None:
    """Print that the server stops, start the time limit, and call ``announce``. Runs in a signal handler."""
    print_stopping()
    end_in_time()
    announce()


class StoppableServer(uvicorn.Server):
    """Server that calls ``on_stop`` immediately after a signal, so that the event streams end. uvicorn alone would wait
    for the streams and then abort them."""

    def __init__(self, config: uvicorn.Config, on_stop: Callable[[], None]) -> None:
        super().__init__(config)
        self._on_stop = on_stop

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Stop gracefully on the first signal, immediately on the second."""
        self._on_stop()
        super().handle_exit(sig, frame)


class StopSignals:
    """Handler of SIGINT and SIGTERM from the time when the address is printed. uvicorn handles signals only after its
    start, so an earlier signal would be lost."""

    def __init__(self) -> None:
        self._server: uvicorn.Server | None = None
        self._early: int | None = None
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._received)

    def attach(self, server: uvicorn.Server) -> None:
        """Pass signals to this server from now on, including a signal that was received earlier."""
        self._server = server
        if self._early is not None:
            server.handle_exit(self._early, None)

    def _received(self, sig: int, frame: FrameType | None) -> None:
        if self._server is not None:
            self._server.handle_exit(sig, frame)
            return
        self._early = sig
        print_stopping()
        end_in_time()


def _end() -> None:
    busy = sorted({thread.name for thread in threading.enumerate() if not thread.daemon} - {"MainThread"})
    _print(
        "stopped while work was in progress: resumable jobs continue after the next start, other work is discarded\n"
    )
    log.info("threads still running: %s", ", ".join(busy) or "only daemon threads")
    for child in multiprocessing.active_children():
        child.kill()
    os._exit(0)


def _print(text: str) -> None:
    with contextlib.suppress(OSError):
        os.write(2, text.encode())

"""Supervisor of the API workers: starts them, restarts them if they exit, and stops them with the link process."""

from __future__ import annotations

import json
import logging
import os
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gss.operations.clock import monotonic_s
from gss.settings import Settings

log = logging.getLogger("gss.workers")
FIRST_WAIT_S, LONGEST_WAIT_S = 0.2, 10.0
STEADY_S = 30.0
END_WITHIN_S = 6.0
MOST = 16
PRIVATE_BACKLOG = 512
Tell = Callable[[str, str], None]
"""(severity, text)."""


@dataclass(frozen=True)
class Order:
    """Start parameters of a worker. ``link``: path of the link process's socket; ``listener``: descriptor of the shared
    public socket."""

    settings: Settings
    link: str
    listener: int

    def as_json(self) -> str:
        """Return the parameters as one line of JSON."""
        settings = self.settings.model_dump(mode="json")
        return json.dumps({"settings": settings, "link": self.link, "listener": self.listener})

    @staticmethod
    def from_json(text: str) -> Order:
        """Parse the parameters in the worker process."""
        told = json.loads(text)
        return Order(Settings(**told["settings"]), told["link"], told["listener"])


@dataclass
class Worker:
    """One worker slot. ``restarts``: how many times its process was restarted."""

    number: int
    process: subprocess.Popen[str]
    since_s: float
    restarts: int = 0
    wait_s: float = field(default=0.0, repr=False)


class Crew:
    """Starts ``count`` workers and keeps that number alive until :meth:`stop`."""

    def __init__(self, order: Order, count: int, tell: Tell) -> None:
        self._order, self._tell = order, tell
        self._stopping = threading.Event()
        self._ready = False
        self._lock = threading.Lock()
        self._workers = [Worker(k + 1, self._process(), monotonic_s()) for k in range(count)]
        self._threads = [threading.Thread(target=self._watch, args=(w,), daemon=True) for w in self._workers]

    def go(self) -> None:
        """Let the workers start to serve, and watch them; called when the link process is ready."""
        with self._lock:
            self._ready = True
            for worker in self._workers:
                self._say(worker.process)
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Let requests in progress end, then stop the processes."""
        self._stopping.set()
        with self._lock:
            processes = [worker.process for worker in self._workers]
        for process in processes:
            if process.poll() is None:
                process.terminate()
        end_s = monotonic_s() + END_WITHIN_S
        for process in processes:
            try:
                process.wait(timeout=max(0.1, end_s - monotonic_s()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdin:
                process.stdin.close()

    def states(self) -> list[dict[str, Any]]:
        """Return number, process id, uptime in seconds and restart count of each worker."""
        with self._lock:
            return [
                {"number": w.number, "pid": w.process.pid, "up_s": monotonic_s() - w.since_s, "restarts": w.restarts}
                for w in self._workers
            ]

    def _process(self) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "gss.api.workers.worker"]
        pipe, inherited = subprocess.PIPE, [self._order.listener]
        return subprocess.Popen(command, stdin=pipe, text=True, pass_fds=inherited)  # noqa: S603 - our own program

    def _say(self, process: subprocess.Popen[str]) -> None:
        try:
            if process.stdin:
                process.stdin.write(self._order.as_json() + "\n")
                process.stdin.flush()
        except OSError:
            log.warning("API worker %s ended before it began", process.pid)

    def _watch(self, worker: Worker) -> None:
        while True:
            code = worker.process.wait()
            if self._stopping.is_set():
                return
            if worker.process.stdin:
                worker.process.stdin.close()
            lived_s = monotonic_s() - worker.since_s
            worker.wait_s = 0.0 if lived_s > STEADY_S else min(LONGEST_WAIT_S, max(FIRST_WAIT_S, 2 * worker.wait_s))
            cause = f"signal {-code}" if code < 0 else f"code {code}"
            self._tell("warning", f"API worker {worker.number} ended ({cause}); it is started again")
            if self._stopping.wait(worker.wait_s):
                return
            with self._lock:
                worker.process, worker.since_s = self._process(), monotonic_s()
                worker.restarts += 1
                self._say(worker.process)


@contextmanager
def private_socket() -> Iterator[tuple[socket.socket, Path]]:
    """Create a Unix socket that only this user can open, in a temporary folder that is deleted on exit."""
    with tempfile.TemporaryDirectory(prefix="gss-") as folder:  # mode 0700; a socket path must be short
        path = Path(folder) / "link"
        listener = socket.socket(socket.AF_UNIX)
        before = os.umask(0o177)
        try:
            listener.bind(str(path))
        finally:
            os.umask(before)
        listener.listen(PRIVATE_BACKLOG)
        with listener:
            yield listener, path

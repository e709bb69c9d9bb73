"""Largest memory of a server and of a browser while a block runs."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

import psutil  # type: ignore[import-untyped]  # the package has no types

SAMPLE_S = 0.5


@dataclass
class Memory:
    """Largest memory of the server's and the browser's processes in MB (proportional share of shared pages)."""

    server_pid: int
    server_mb: float = 0.0
    browser_mb: float = 0.0
    _end: threading.Event = field(default_factory=threading.Event)

    def sample(self) -> None:
        """Update both maxima."""
        server = _family(self.server_pid)
        self.server_mb = max(self.server_mb, sum(map(_share_mb, server)))
        browser = [p for p in _family(os.getpid()) if p not in server and _is_browser(p)]
        self.browser_mb = max(self.browser_mb, sum(map(_share_mb, browser)))

    @contextlib.contextmanager
    def watched(self) -> Iterator[None]:
        """Sample until the end of the block."""

        def run() -> None:
            while not self._end.wait(SAMPLE_S):
                self.sample()

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield
        finally:
            self._end.set()
            thread.join()


def _family(pid: int) -> list[psutil.Process]:
    """Return a process and its descendants."""
    with contextlib.suppress(psutil.NoSuchProcess):
        first = psutil.Process(pid)
        return [first, *first.children(recursive=True)]
    return []


def _share_mb(process: psutil.Process) -> float:
    with contextlib.suppress(psutil.Error):
        return float(process.memory_full_info().pss) / 2**20
    return 0.0


def _is_browser(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return "chrom" in process.name()
    return False

"""Largest memory of a server and of a browser while a block runs."""

from __future__ import annotations

import contextlib
import os
import re
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

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
        browser = [pid for pid in _family(os.getpid()) if pid not in server and "chrom" in _program(pid)]
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


def _family(pid: int) -> set[int]:
    """Return a process and its descendants."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError, IndexError):
            fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
            parents.setdefault(int(fields[1]), []).append(int(entry.name))
    found, waiting = set[int](), [pid]
    while waiting:
        found.add(pid := waiting.pop())
        waiting += parents.get(pid, [])
    return found


def _share_mb(pid: int) -> float:
    with contextlib.suppress(OSError):
        text = Path(f"/proc/{pid}/smaps_rollup").read_text()
        if match := re.search(r"^Pss:\s+(\d+) kB", text, re.MULTILINE):
            return int(match[1]) / 1024
    return 0.0


def _program(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")[0].decode(errors="replace")
    return ""

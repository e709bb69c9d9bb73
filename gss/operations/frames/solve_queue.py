"""Queue of frames that wait to be solved, in order of arrival, and the thread that solves them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.operations.events import EventBus
from gss.store.models import Frame

MAX_WAITING = 200
MAX_PIXEL_BYTES = 256 << 20
"""Maximum total size of the pixels of waiting frames in memory. Pixels of further frames are read from the store later."""
REPORT_EVERY_SKIPPED = 100


@dataclass(frozen=True)
class _Unsolved:
    """A frame that waits to be solved. ``pixels``: None if they must be read from the store."""

    frame: Frame
    pixels: NDArray[np.generic] | None


class SolveQueue:
    """Calls ``solve`` for each frame in a separate thread. ``solve`` receives None if it must read the pixels from the store. It
    must not raise."""

    def __init__(self, solve: Callable[[Frame, NDArray[np.generic] | None], None], bus: EventBus) -> None:
        self._solve, self._bus = solve, bus
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="solve")
        self._unsolved: deque[_Unsolved] = deque()
        self.skipped = 0
        """Number of frames that were dropped without a solution since the server started, because frames arrived too
        fast."""

    def __len__(self) -> int:
        return len(self._unsolved)

    def add(self, frame: Frame, pixels: NDArray[np.generic]) -> None:
        """Queue a frame. If too many frames are waiting, the oldest is dropped. Dropped frames are counted and reported."""
        in_memory = sum(unsolved.pixels.nbytes for unsolved in list(self._unsolved) if unsolved.pixels is not None)
        fits = in_memory + pixels.nbytes <= MAX_PIXEL_BYTES
        self._unsolved.append(_Unsolved(frame, pixels if fits else None))
        if len(self._unsolved) > MAX_WAITING:
            self._unsolved.popleft()
            self.skipped += 1
            if self.skipped % REPORT_EVERY_SKIPPED == 1:
                text = f"Frames arrive faster than they are solved: {self.skipped} skipped. Rerun them from Campaigns"
                self._bus.record("solution", "warning", text)
        else:
            self._pool.submit(self._next)

    def submit(self, work: Callable[[], None]) -> None:
        """Run other work in the thread of the solver, after the waiting frames."""
        self._pool.submit(work)

    def stop(self) -> None:
        """Finish the current solution and drop the waiting frames."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _next(self) -> None:
        if self._unsolved:
            waiting = self._unsolved.popleft()
            self._solve(waiting.frame, waiting.pixels)

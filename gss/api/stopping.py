"""The end of the server: in order if the work under way allows it, in time in any case."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import threading

STOP_WITHIN_S = 4.5
"""From the signal. Stored data survives kill -9, so an end in the middle of a computation loses nothing acknowledged."""


def say_stopping() -> None:
    """Print at once that the signal was received, past Python's own streams, which the signal may have interrupted."""
    _print("\nstopping …\n")


def end_in_time(seconds: float = STOP_WITHIN_S) -> None:
    """End the process after that time even if threads are still computing. Their names are printed; child processes end too."""
    timer = threading.Timer(seconds, _end)
    timer.daemon = True
    timer.start()


def _end() -> None:
    busy = sorted({thread.name for thread in threading.enumerate() if not thread.daemon} - {"MainThread"})
    _print(f"stopped while work was under way: {', '.join(busy) or 'requests'}; it is not lost if it can be resumed\n")
    for child in multiprocessing.active_children():
        child.kill()
    os._exit(0)


def _print(text: str) -> None:
    with contextlib.suppress(OSError):
        os.write(2, text.encode())

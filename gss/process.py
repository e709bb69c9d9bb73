"""Garbage collection during the start and the end of a process.

A server creates 250 000 objects while it imports its modules. With Python's usual thresholds, the collector examines them
many times during the start and once more at the end: a third of the processor time of a start and a stop.
"""

from __future__ import annotations

import gc

OBJECTS_OF_A_START = 100_000
_USUAL = gc.get_threshold()


def starting() -> None:
    """Collect rarely while modules are imported."""
    gc.set_threshold(OBJECTS_OF_A_START, *_USUAL[1:])


def started() -> None:
    """Exclude the objects of the start from all collections, and collect as usual. For a process that runs long."""
    gc.freeze()
    gc.set_threshold(*_USUAL)


def ending() -> None:
    """Exclude all objects from the last collection, because the memory of a process is freed when it ends."""
    gc.freeze()

"""Garbage collection during the start and at the end of a process.

A server creates 250 000 objects while it imports its modules. With Python's thresholds, the collector examines them many
times during the start and once more at the end: a third of the processor time of a start and a stop.
"""

from __future__ import annotations

import gc

OBJECTS = 20_000
_USUAL = gc.get_threshold()


def collect_rarely() -> None:
    """Collect rarely, for a process that imports modules, or that ends soon."""
    gc.set_threshold(OBJECTS, *_USUAL[1:])


def collect_as_usual() -> None:
    """Exclude the objects of the start from all collections, and collect with Python's thresholds. For a process that runs
    long."""
    gc.freeze()
    gc.set_threshold(*_USUAL)


def skip_last_collection() -> None:
    """Exclude all objects from the collection at the end of the process. What needs a destructor, for example a database,
    must be closed before."""
    gc.freeze()

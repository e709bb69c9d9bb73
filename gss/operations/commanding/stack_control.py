"""Inputs of a running stack: operator requests, telemetry, and the results of its commands."""

from __future__ import annotations

import threading
from collections.abc import Mapping

from gss.instruments.dictionary.definitions import Value


class Stopped(Exception):
    """Raised to end a run before its last step. ``state``: stopped or failed."""

    def __init__(self, state: str, reason: str) -> None:
        super().__init__(reason)
        self.state, self.reason = state, reason


class RunControl:
    """Requests and inputs for a run. The run checks them between steps and during steps."""

    def __init__(self, aborts: int) -> None:
        self.aborts = aborts
        """Number of ABORTs issued before the run began. After a further ABORT no step is executed."""
        self.pause = False
        self.stop_reason = ""
        self.changed = threading.Condition()
        self.results: dict[int, str] = {}
        self.packets: dict[str, tuple[float, Mapping[str, Value]]] = {}

    def notify(self) -> None:
        """Wake the run, which then checks its inputs immediately."""
        with self.changed:
            self.changed.notify_all()

"""Inputs of a running stack: operator requests, telemetry and the results of its commands."""

from __future__ import annotations

import threading
from collections.abc import Mapping

from gss.instruments.dictionary.definitions import Value


class Stopped(Exception):
    """Ends the run before its last step. ``state``: stopped or failed."""

    def __init__(self, state: str, reason: str) -> None:
        super().__init__(reason)
        self.state, self.reason = state, reason


class RunControl:
    """Requests and inputs for a run, checked between and within steps."""

    def __init__(self, aborts: int) -> None:
        self.aborts = aborts
        """Number of ABORTs issued when the run began; a later ABORT stops every step."""
        self.pause = False
        self.stop_reason = ""
        self.changed = threading.Condition()
        self.results: dict[int, str] = {}
        self.packets: dict[str, tuple[float, Mapping[str, Value]]] = {}

    def notify(self) -> None:
        """Wake the run so that it checks its inputs at once."""
        with self.changed:
            self.changed.notify_all()

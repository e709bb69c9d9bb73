"""Inputs of a running stack: the operator's orders, telemetry, and the results of its commands."""

from __future__ import annotations

import threading
from collections.abc import Mapping

from gss.instruments.dictionary.definitions import Value


class Stopped(Exception):
    """Ends the run before its last step. ``state``: stopped or failed."""

    def __init__(self, state: str, reason: str) -> None:
        super().__init__(reason)
        self.state, self.reason = state, reason


class Orders:
    """Requests and inputs for a run, checked between and within steps."""

    def __init__(self, aborts: int) -> None:
        self.aborts = aborts
        """Number of ABORTs issued when the run began; a later ABORT stops every step."""
        self.pause = False
        self.stop_reason = ""
        self.bell = threading.Condition()
        self.results: dict[int, str] = {}
        self.packets: dict[str, tuple[float, Mapping[str, Value]]] = {}

    def ring(self) -> None:
        """Wake the run so that it checks its inputs at once."""
        with self.bell:
            self.bell.notify_all()

"""What a run of a stack is told while it runs: orders of the operator, telemetry, what became of its commands."""

from __future__ import annotations

import threading
from collections.abc import Mapping

from gss.device.dictionary import Value


class Stopped(Exception):
    """The run ends before its last step: ``state`` is stopped or failed."""

    def __init__(self, state: str, reason: str) -> None:
        super().__init__(reason)
        self.state, self.reason = state, reason


class Orders:
    """What an operator wants of a run; looked at between and within steps."""

    def __init__(self, aborts: int) -> None:
        self.aborts = aborts
        """How many ABORTs had been issued when the run began: a later one stops every step."""
        self.pause = False
        self.stop_reason = ""
        self.bell = threading.Condition()
        self.results: dict[int, str] = {}
        self.packets: dict[str, tuple[float, Mapping[str, Value]]] = {}

    def ring(self) -> None:
        """Let the run look at once."""
        with self.bell:
            self.bell.notify_all()

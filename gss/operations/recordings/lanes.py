"""State lanes of a recording: mode, active bank, link and the stage of the command in progress."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime, timedelta
from typing import Any

from gss.store.models import Command

LANES = {"mode": "mode", "active_bank": "bank"}
"""Housekeeping fields that have a lane, with the name of the lane."""
SILENT_AFTER = timedelta(seconds=5)
Log = Callable[[datetime, str, str | None], None]


class Lanes:
    """Writes each change of a state. ``log`` receives the time, the path of the lane and the new state; None ends the
    state. Not thread-safe."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self._shown: dict[str, str] = {}
        self._last_packet: datetime | None = None

    def telemetry(self, received: datetime, values: Mapping[str, Any]) -> None:
        """Record the states in a packet. If the previous packet is older than SILENT_AFTER, also record that the link
        was silent in between."""
        last = self._last_packet
        if last is not None and received - last > SILENT_AFTER:
            self._change(last + SILENT_AFTER, "link", "no packets")
        self._change(received, "link", "up")
        self._last_packet = received if last is None else max(last, received)
        for field, lane in LANES.items():
            if values.get(field) is not None:
                self._change(received, lane, str(values[field]))

    def command(self, row: Command) -> None:
        """Record the stages of a command. The lane is empty between commands."""
        for stage in row.stages:
            self._log(stage.at, "states/command", f"{row.name} {stage.stage}")
        if row.finished is not None:
            self._log(row.finished, "states/command", None)

    def _change(self, at: datetime, lane: str, state: str) -> None:
        if self._shown.get(lane) != state:
            self._shown[lane] = state
            self._log(at, f"states/{lane}", state)

"""State of all units of a server."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import Out
from gss.api.schemas.link import LinkOut


class FleetUnitOut(Out):
    """State of one unit. ``process``: state of the unit's process; ``restarts``, ``last_end``: number of restarts and
    last exit of this process since the server started; ``reason``: why the process could not start, "" if it started;
    ``process_age_s``: time since the start of the process, None while it does not run.
    ``link``: last report of the unit, received ``age_s`` ago; ``current``: false if this report is too old."""

    name: str
    instrument: str
    address: str
    process: Literal["starting", "running", "ended"]
    restarts: int
    last_end: str
    reason: str
    process_age_s: float | None
    link: LinkOut | None
    age_s: float | None
    current: bool


class FleetOut(Out):
    """Units of this server; empty if it serves a single unnamed unit."""

    units: list[FleetUnitOut]

"""State of all units of a server."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import Out
from gss.api.schemas.link import LinkOut


class FleetUnitOut(Out):
    """One unit. ``process``: of the unit's own process, ``restarts`` and ``last_end`` since the server started; ``reason``:
    why it could not start, "" if it could. ``link``: what the unit reported last, ``age_s`` ago; ``current``: False if that
    is too old to be true now."""

    name: str
    instrument: str
    address: str
    process: Literal["starting", "running", "ended"]
    restarts: int
    last_end: str
    reason: str
    link: LinkOut | None
    age_s: float | None
    current: bool


class FleetOut(Out):
    """The units of this server; none if it serves a single one without a name."""

    units: list[FleetUnitOut]

"""All units of a server: their processes and their latest reported states."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from httpx2 import TransportError

from gss.api.schemas.link import AttitudeSampleOut, LinkOut
from gss.api.stream.broadcast import FIRST
from gss.api.units.unit_process import reason_file
from gss.api.units.unit_spec import UnitSpec
from gss.api.workers.link_client import LinkProcessClient
from gss.api.workers.supervisor import ProcessState, Supervisor
from gss.domain.errors import NotFound
from gss.operations.clock import Monotonic
from gss.operations.telemetry.last_attitude import AttitudeSample

RECONNECT_S = 0.3
NO_UNIT = "this server has no such unit"


@dataclass(frozen=True)
class UnitState:
    """State of one unit. ``link``: last report of its process, received ``age_s`` ago; None before the first report.
    ``reports``: true if this process is connected, so that the report is not that of an earlier process. ``reason``: why
    the process could not start; "" if it started. ``process_age_s``: time since the start of the process; None while it
    does not run."""

    spec: UnitSpec
    process: ProcessState
    reason: str
    process_age_s: float | None
    reports: bool
    link: LinkOut | None
    age_s: float | None


class Fleet:
    """Units of the server. Follows the event stream of every unit's process. ``paths``: sockets of the processes by
    unit name; ``take_attitudes``: called with the unit name and its latest attitudes."""

    def __init__(
        self,
        units: tuple[UnitSpec, ...],
        paths: Mapping[str, Path],
        supervisor: Supervisor,
        take_attitudes: Callable[[str, Sequence[AttitudeSample]], None],
        monotonic_s: Monotonic,
    ) -> None:
        self._units, self._paths, self._supervisor = units, paths, supervisor
        self._take_attitudes = take_attitudes
        self._clients = {name: LinkProcessClient(f"of unit {name}", path) for name, path in paths.items()}
        self._monotonic_s = monotonic_s
        self._latest: dict[str, tuple[float, LinkOut]] = {}
        self._connected: set[str] = set()

    @property
    def names(self) -> list[str]:
        """Names of the units in the configured order."""
        return [unit.name for unit in self._units]

    def client(self, name: str) -> LinkProcessClient | None:
        """Return the client of a unit's process; None if there is no such unit."""
        return self._clients.get(name)

    def states(self) -> list[UnitState]:
        """Return the state of every unit."""
        return [self._state(unit) for unit in self._units]

    def restart(self, name: str, user: str) -> None:
        """End the process of a unit, which is then started again. Raises NotFound if there is no such unit, Conflict if its
        process does not run."""
        unit = next((unit for unit in self._units if unit.name == name), None)
        if unit is None:
            raise NotFound(NO_UNIT, expected=f"one of {', '.join(self.names)}", got=name)
        self._supervisor.restart(process_name(unit), f"user {user}")

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Start the processes and follow them until the end of the block. The processes are stopped separately when the
        server stops."""
        self._supervisor.start()
        tasks = [asyncio.create_task(self._follow(name, client)) for name, client in self._clients.items()]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    def _state(self, unit: UnitSpec) -> UnitState:
        process, latest = self._supervisor.state(process_name(unit)), self._latest.get(unit.name)
        reason = process.obstacle or _read(reason_file(self._paths[unit.name]))
        process_age_s = None if process.start_s is None else max(0.0, self._monotonic_s() - process.start_s)
        if latest is None:
            return UnitState(unit, process, reason, process_age_s, False, None, None)
        at_s, report = latest
        reports = unit.name in self._connected
        return UnitState(unit, process, reason, process_age_s, reports, report, max(0.0, self._monotonic_s() - at_s))

    async def _follow(self, name: str, client: LinkProcessClient) -> None:
        """Store the latest state of a unit. The state is kept after the process ends; its age then increases."""
        while True:
            with contextlib.suppress(TransportError):
                async with contextlib.aclosing(client.messages()) as messages:
                    async for message in messages:
                        if message.topic == FIRST:
                            report = LinkOut.model_validate_json(message.content)
                            self._latest[name] = (self._monotonic_s(), report)
                            self._connected.add(name)
                            self._take_attitudes(name, [_sample(attitude) for attitude in report.attitudes])
            self._connected.discard(name)
            await asyncio.sleep(RECONNECT_S)


def _sample(sent: AttitudeSampleOut) -> AttitudeSample:
    return AttitudeSample(**vars(sent))


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except FileNotFoundError:
        return ""


def process_name(unit: UnitSpec) -> str:
    """Return the name of a unit's process in the supervisor and in events."""
    return f"unit {unit.name}"

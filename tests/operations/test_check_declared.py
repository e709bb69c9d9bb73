"""``gss check device`` with third-party sensors: the simulated units do what their packages declare, and a broken one fails."""

from __future__ import annotations

from importlib.metadata import entry_points

import numpy as np
import pytest

from gss.device.driver import open_driver
from gss.device.simulator.environment import Environment
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.other_makers import SIMULATORS, SimulatedUnit, UnitWorld
from gss.domain.frames import cam_from_icrs
from gss.instruments.package import Instrument
from gss.instruments.registry import shipped_registry
from gss.operations.checks.check_declared import check_declared
from gss.operations.checks.check_findings import Case
from gss.operations.checks.direct import DirectDevice

STEP_S = 0.02
ATTITUDE = cam_from_icrs(*np.radians([84.0, 5.0, 30.0]))


class MemoryLine:
    """Line to a simulated unit in this process. Time advances only while a caller reads. ``deaf``: requests are lost."""

    url = "memory"

    def __init__(self, unit: SimulatedUnit) -> None:
        self._unit, self.now_s, self.deaf = unit, 0.0, False

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Return the bytes of the unit at the next step."""
        self.now_s += STEP_S
        self._unit.advance(self.now_s)
        return b"".join(iter(lambda: self._unit.next_frame(self.now_s) or b"", b""))

    def write(self, data: bytes) -> None:
        """Pass bytes to the unit."""
        if not self.deaf:
            self._unit.feed(data, self.now_s)

    def close(self) -> None:
        """Do nothing: there are no resources to release."""


def line_to(instrument: Instrument, *dialects: str) -> MemoryLine:
    """Return a line to a simulated unit of the instrument."""
    assert instrument.simulator is not None
    program = instrument.simulator.program
    environment = Environment(instrument.profile, Inertial(ATTITUDE, np.zeros(3)))
    factory = entry_points(group=SIMULATORS)[program].load()
    return MemoryLine(factory(UnitWorld(instrument, environment, 1, frozenset(dialects))))


def device_on(line: MemoryLine, instrument: Instrument) -> DirectDevice:
    return DirectDevice(line, open_driver(instrument), instrument.dictionary, lambda: line.now_s)


def failures(cases: list[Case]) -> list[Case]:
    return [case for case in cases if case.passed is False]


@pytest.mark.parametrize(("name", "dialects"), [("nos3", ()), ("sagitta", ("booted",)), ("oresat", ())])
def test_a_simulated_unit_passes_every_check_of_its_package(name: str, dialects: tuple[str, ...]) -> None:
    """Every declared operation with a command is completed or skipped with a reason, every declared quantity arrives, and the
    unit answers after noise."""
    instrument = shipped_registry().get(name)
    cases = check_declared(device_on(line_to(instrument, *dialects), instrument), instrument, write=False)
    assert failures(cases) == []
    assert [case.subject for case in cases if case.passed is None and not case.detail] == []
    passed = {case.subject.split(" ")[0] for case in cases if case.passed}
    assert passed > set(instrument.roles.quantities.roles())
    assert "answers" in passed


def test_a_sagitta_in_its_bootloader_fails() -> None:
    """A unit that sends no telemetry fails its requests and quantities, but still answers after noise."""
    instrument = shipped_registry().get("sagitta")
    failed = {
        case.subject
        for case in failures(check_declared(device_on(line_to(instrument), instrument), instrument, write=False))
    }
    assert "get_status (REQUEST_TEMPERATURE)" in failed
    assert "attitude (solution)" in failed
    assert not any("noise" in subject for subject in failed)


def test_a_unit_that_stops_answering_fails() -> None:
    """Requests that are lost after the identity fail the operations and the answer after noise."""
    instrument = shipped_registry().get("nos3")
    line = line_to(instrument)
    device = device_on(line, instrument)
    line.deaf = True
    failed = {case.subject for case in failures(check_declared(device, instrument, write=False))}
    assert "answers after noise on the line" in failed
    assert any("attitude" in subject for subject in failed)

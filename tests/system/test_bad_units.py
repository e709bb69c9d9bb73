"""Defects of one unit: broken package, drivers that raise or hang. The fleet reports a state for each, and the other units
are not affected. Faults of lines are in ``test_new_unit.py``."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gss.instruments.registry import SHIPPED

pytestmark = pytest.mark.timeout(1800)
LONG_S = 600.0
DRIVERS = """
import time
from gss.device import link_driver

class Faulty:
    def __init__(self, session, fault):
        self._session, self._fault = session, fault

    def __getattr__(self, name):
        return getattr(self._session, name)

    def feed(self, data, now_s):
        self._fault()

def no_field():
    raise ValueError("no such field")

def raises(setup):
    return Faulty(link_driver.open_session(setup), no_field)

def hangs(setup):
    return Faulty(link_driver.open_session(setup), lambda: time.sleep(600))
"""
EXPECTED = {
    "BROKEN": "must be one of",
    "RAISES": "Line down: ValueError: no such field",
    "HANGS": "the driver of the instrument hangs: restart the server",
}
"""What the fleet reports of each unit: the reason why its process cannot start, or an alarm."""


@pytest.fixture
def packages(tmp_path: Path) -> Path:
    """Folder of a Python package with the drivers. The data folder has a package for each, and a broken package."""
    code = tmp_path / "code"
    (code / "faulty-1.dist-info").mkdir(parents=True)
    (code / "faulty.py").write_text(DRIVERS)
    (code / "faulty-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: faulty\nVersion: 1\n")
    (code / "faulty-1.dist-info" / "entry_points.txt").write_text(
        "[gss.drivers]\nraises = faulty:raises\nhangs = faulty:hangs\n"
    )
    for name in ("raises", "hangs", "broken"):
        folder = tmp_path / "data" / "instruments" / name
        shutil.copytree(SHIPPED / "nos3", folder)
        about = (folder / "instrument.yaml").read_text().replace("id: nos3", f"id: {name}")
        (folder / "instrument.yaml").write_text(about.replace("driver: link", f"driver: {name}"))
        link = (folder / "link.yaml").read_text()
        (folder / "link.yaml").write_text(link.replace("stalled_after_s: 20.0", "stalled_after_s: 1.0"))
    return code


def test_each_defect_has_a_clear_state_and_costs_the_other_units_nothing(
    start_units: Callable[..., Any], packages: Path
) -> None:
    """The fleet reports what is wrong with each unit. During all this, the good unit has one contact without a gap."""
    simulated = [f"{unit}={unit.lower()}@simulator" for unit in ("RAISES", "HANGS", "BROKEN")]
    units = start_units("GOOD=nos3@simulator", *simulated, PYTHONPATH=str(packages))

    def state(name: str) -> str:
        unit = units.fleet()[name]
        alarms = unit["link"]["alarms"] if unit["current"] else []
        return "; ".join([unit["reason"], *(alarm["text"] for alarm in alarms)])

    contact = units.connected("GOOD")["GOOD"]["link"]["contact_id"]
    for name, words in EXPECTED.items():
        units.console.wait(f"{name}: {words}", lambda name=name, words=words: words in state(name), LONG_S)
    with units.http("RAISES") as http:
        assert len(http.get("/contacts").json()) == 1, "the attempts are one contact"
    good = units.fleet()["GOOD"]
    assert (good["restarts"], good["link"]["contact_id"], good["link"]["rx"]["state"]) == (0, contact, "up")
    with units.http("GOOD") as http:
        assert http.get(f"/contacts/{contact}").json()["gaps"] == []

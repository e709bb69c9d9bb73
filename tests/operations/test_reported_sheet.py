"""Performance sheet of a sensor that reports attitudes and star lists but no images, from the telemetry of a contact."""

from __future__ import annotations

import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from gss.device.driver import open_driver
from gss.device.session_events import Telemetry
from gss.device.simulator.environment import Environment
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.other_makers import UnitWorld
from gss.device.simulator.sagitta import BOOTED, SIGMA_ARCSEC, SIGMA_PX, SagittaUnit, open_unit
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import rotation_from_vector
from gss.instruments.registry import shipped_registry
from gss.operations.studies.analysis_requests import SheetRequest
from gss.operations.telemetry.telemetry import stored_values
from gss.settings import Settings
from gss.store.models import Analysis, Contact, TelemetryPacket
from gss.wiring.build import build

START = datetime(2026, 3, 1, tzinfo=UTC)
SECONDS, STEP_S = 50, 0.25
RATE_RAD_S = np.radians([0.08, -0.03, 0.02])
"""Rate at which the stars cross the detector."""
ATTITUDE = cam_from_icrs(*np.radians([84.0, 5.0, 30.0]))
SAGITTA = shipped_registry().get("sagitta")


def packets_of_contact() -> list[Telemetry]:
    """Return the telemetry of a simulated unit that sends solutions and centroids five times a second."""
    start_s = START.timestamp()
    attitude = rotation_from_vector(RATE_RAD_S * start_s) @ ATTITUDE
    environment = Environment(SAGITTA.profile, Inertial(attitude, RATE_RAD_S))
    unit: SagittaUnit = open_unit(UnitWorld(SAGITTA, environment, 3, frozenset([BOOTED])))
    session = open_driver(SAGITTA)
    session.link_up(start_s)
    session.submit(session.encode("SET_SUBSCRIPTION", {"telemetry_1": 24, "telemetry_2": 37}))
    packets: list[Telemetry] = []
    for k in range(round(SECONDS / STEP_S)):
        now_s = start_s + STEP_S * k
        unit.feed(session.poll(now_s)[0], now_s)
        unit.advance(now_s)
        while (frame := unit.next_frame(now_s)) is not None:
            packets += [e for e in session.feed(frame, now_s) if isinstance(e, Telemetry) and not e.request_id]
    return packets


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    """Sheet of the contact."""
    services = build(Settings(data=Path(tmp_path_factory.mktemp("sagitta"))))
    services.base.jobs.start()
    try:
        with services.base.database.unit_of_work() as session:
            contact = Contact(url="test", started=START, ended=START + timedelta(seconds=SECONDS))
            session.add(contact)
            session.flush()
            for packet in packets_of_contact():
                session.add(
                    TelemetryPacket(
                        contact_id=contact.id,
                        packet=packet.packet,
                        received=datetime.fromtimestamp(packet.device_time_s, UTC),
                        device_time_s=packet.device_time_s,
                        request_id=packet.request_id,
                        values=stored_values(packet),
                    )
                )
        request = SheetRequest(kind="sheet", profile="sagitta", contact=contact.id)
        job = services.studies.analyses.start(request, user="engineer")
        end = time.monotonic() + 600
        while (current := services.base.jobs.get(job.id)).state in ("queued", "running"):
            assert time.monotonic() < end
            time.sleep(0.05)
        assert current.state == "done", current.text
        row = services.studies.analyses.get(int(current.result["analysis_id"]))
        assert services.studies.analyses.export(row.id, "pdf").startswith(b"%PDF")
        return row
    finally:
        services.base.jobs.stop()
        services.base.database.close()


def test_the_reported_attitudes_give_the_noise(sheet: Analysis) -> None:
    """The noise of the reported attitudes is within the intervals, for each axis. Every attitude was reported."""
    rows = {r["key"]: r for r in sheet.result["figures"]["rows"]}
    for figure, sigma_arcsec in zip(rows["temporal-noise"]["figures"], SIGMA_ARCSEC, strict=True):
        assert figure["low"] <= sigma_arcsec <= figure["high"]
    assert rows["acquisition"]["figures"][0]["value"] == 100
    assert rows["tracking"]["measured"]


def test_the_star_lists_give_the_spatial_errors(sheet: Analysis) -> None:
    """The ground solves the star lists. A perfect lens has no spatial error, and the scatter is that of the positions."""
    rows = {r["key"]: r for r in sheet.result["figures"]["rows"]}
    assert rows["field-of-view"]["figures"][3]["low"] == 0
    [spatial] = [s for s in sheet.result["report"]["sections"] if s["title"] == "Spatial errors"]
    scatter_px = float(spatial["text"].split("errors ")[1].split(" px")[0])
    assert scatter_px == pytest.approx(SIGMA_PX, rel=0.1)


def test_the_sheet_states_its_source(sheet: Analysis) -> None:
    """The sheet is that of the unit's own results, and rows that need frames state it."""
    figures = sheet.result["figures"]
    assert figures["source"] == "telemetry"
    assert "on board" in figures["chain"]
    assert {"bias", "end-of-life", "robustness"} <= {r["key"] for r in figures["rows"] if r["needs"]}

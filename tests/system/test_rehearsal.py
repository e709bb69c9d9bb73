"""A day with three passes, rehearsed in a separate process and store, on a simulated unit, with a clock that is stepped."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from gss.operations.catalogues.catalogue_request import CatalogueRequest
from gss.operations.passes.plan_items import PlanItem
from gss.operations.rehearsals.rehearsal_report import Outage, RehearsalOptions
from gss.operations.rehearsals.stepped import SteppedClock
from gss.orbit.station import GroundStation
from gss.settings import Settings
from gss.wiring.build import build

pytestmark = pytest.mark.timeout(600)
START = datetime(2026, 11, 25, 6, tzinfo=UTC)
"""Time of the server, so that the passes are the same whenever the test runs."""
PREPARE = """# Prepare the upload

## status: Ask for the status

```command
GET_STATUS
```

## clear: May the catalogue be replaced?

```question
Is bank B free?
yes: stop
no: end
```

## stop: Stop the cycle

```command
STOP_CYCLE
```
"""


@pytest.fixture
def services(tmp_path: Path, tle_of: Callable[..., str]) -> Any:
    """Services that were not started, with an orbit, a station with a slow line, a procedure and a catalogue."""
    services = build(Settings(data=tmp_path / "data"), clock=SteppedClock(START).clock)
    place = GroundStation("Longyearbyen", 1.36544, 0.27299, 450.0, 0.0873)
    services.passes.stations.create(place, "", 38_400, "", user="ann")
    services.passes.spacecraft.set(tle_of(1, START), name="", source="", user="ann")
    services.procedures.procedures.create(PREPARE, user="ann")
    request = CatalogueRequest(name="bright", profile="cubestar", format="cubestar", faint_mag=2.2)
    services.catalogues.catalogues.build(request, user="ann")
    services.base.jobs.finish()
    yield services
    services.stop()


def plan_of(services: Any, *items: PlanItem, resume: bool = True) -> Any:
    """Return a plan for the first long pass over the station."""
    soon = START + timedelta(minutes=5)
    first = next(p for p in services.passes.table.upcoming(3).passes if p.at.rise > soon and p.at.duration_s > 240)
    return services.passes.plans.create("Day", first.station.id, first.at.culmination, items, resume=resume, user="ann")


def test_a_day_with_three_passes_is_rehearsed(services: Any) -> None:
    """Acquisition, a question, an upload that is lost twice and completed in the third pass; nothing of it is in the server's
    record."""
    procedure, catalogue = services.procedures.procedures.list_all()[0], services.catalogues.catalogues.newest(1)[0]
    plan = plan_of(
        services,
        PlanItem("procedure", "", 60.0, procedure_id=procedure.id),
        PlanItem("upload", "", 60.0, catalogue_id=catalogue.id, bank="B"),
    )
    progress: list[float] = []
    report = services.passes.rehearsals.run(
        plan.id,
        RehearsalOptions(
            answers={"clear": "yes"},
            outages=[
                Outage(pass_number=1, after_s=26, for_s=1800),
                Outage(pass_number=2, after_s=10, for_s=1800),
            ],
        ),
        lambda share, text: progress.append(share),
    )
    assert (report.state, [item.state for item in report.items]) == ("completed", ["done", "done"]), report
    states = [change.state for change in report.transitions]
    assert states == ["armed", *["running", "paused", "waiting"] * 2, "running", "completed"]
    assert len(report.passes) == 3
    assert report.passes[0].rise == plan.rise
    lost = report.transitions[2]
    assert lost.reason == "loss of signal"
    assert timedelta(seconds=26) < lost.at - plan.rise < timedelta(seconds=34)
    assert all(one.used_s < one.window_s and one.bytes_up for one in report.passes), [
        (p.used_s, p.window_s, p.bytes_up, p.bytes_down) for p in report.passes
    ]
    assert sum(one.bytes_up for one in report.passes) > catalogue.size
    [answer] = report.person
    assert (answer.step, answer.answer, answer.user) == ("clear", "yes", "rehearsal")
    assert [step.state for step in report.steps] == ["done"] * 3
    assert report.items[1].active_s > catalogue.size / 3840
    assert progress[-1] == 1.0
    assert services.passes.plans.get(plan.id).state == "draft"
    assert (services.procedures.runs.newest(5), services.contacts.contacts.newest(5)) == ([], [])
    assert list((services.base.settings.data / "rehearsals").iterdir()) == []

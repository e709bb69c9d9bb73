"""Derived parameters: computed on reception, stored, checked and plotted like telemetry, and recomputed for the past."""

from __future__ import annotations

import io
from datetime import timedelta
from pathlib import Path
from typing import Any

import h5py
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest

from gss.device.session_events import Telemetry
from gss.domain.errors import BadInput, Conflict, NotFound
from gss.domain.limits import Limits, State
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.jobs import JobService
from gss.operations.line.line_events import LineBatch
from gss.operations.telemetry.derived import DerivedRequest
from gss.operations.telemetry.derived_history import DerivedHistory
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.telemetry.telemetry_export import export
from gss.operations.upkeep.parquet_export import export_parquet

DICTIONARY = load_dictionary()
POWER = "housekeeping.supply_3v3_v * housekeeping.current_imager_ma / 1000"


def request(name: str = "power_w", expression: str = POWER, **more: Any) -> DerivedRequest:
    """Return a definition of a derived parameter."""
    values = {"title": "Power", "unit": "W", "decimals": 3} | more
    return DerivedRequest(name=name, expression=expression, **values)


class Ground:
    """Telemetry and jobs without a link. Each ``receive`` processes one packet."""

    def __init__(self, database: Any, bus: Any, clock: Any) -> None:
        self.clock, self.database = clock, database
        self.telemetry = TelemetryService(
            DICTIONARY, database, bus, clock, lambda: None, lambda: True, default_roles(DICTIONARY).quantities.status
        )
        self.derived = self.telemetry.derived
        self.jobs = JobService(database, bus, clock, lambda _: None)
        self.history = DerivedHistory(self.derived, database, self.jobs, clock)

    def receive(self, packet: str = "housekeeping", **values: Any) -> list[Any]:
        self.clock.forward(1)
        arrived = Telemetry(packet, 100.0, 0, {}, values)
        return self.telemetry.handle(LineBatch((arrived,), self.clock(), 0.0))

    def value(self, name: str = "power_w") -> Any:
        return next(v for v in self.telemetry.values() if v.name == name)

    def plotted(self, name: str = "power_w") -> list[float | None]:
        end = self.clock() + timedelta(hours=1)
        return self.telemetry.archive.history([f"derived_{name}.{name}"], end - timedelta(days=3), end, 500)[0].y


@pytest.fixture
def ground(database: Any, bus: Any, clock: Any) -> Any:
    new_ground = Ground(database, bus, clock)
    yield new_ground
    new_ground.jobs.stop()


def test_a_parameter_is_computed_with_every_packet_and_has_a_history(ground: Ground) -> None:
    """A parameter is computed with every packet, is listed with value, unit and page, and is stored."""
    ground.derived.add(request(), user="ann")
    for current in (100, 200, 300):
        ground.receive(supply_3v3_v=3.0, current_imager_ma=current)
    shown = ground.value()
    assert (shown.value, shown.formatted, shown.unit, shown.page) == (pytest.approx(0.9), "0.900", "W", "derived")
    assert (shown.state, shown.packet) == ("ok", "derived_power_w")
    assert ground.plotted() == pytest.approx([0.3, 0.6, 0.9])
    rows = ground.telemetry.archive.packets("derived_power_w", None, None, 10, None)
    assert [row.values["power_w"] for row in rows] == pytest.approx([0.9, 0.6, 0.3])


def test_limits_of_a_parameter_are_checked(ground: Ground) -> None:
    """The limits are those of the definition, or those of an operator's override."""
    ground.derived.add(request(warning=[None, 0.5]), user="ann")
    [judged] = ground.receive(supply_3v3_v=3.0, current_imager_ma=200)
    assert [(j.packet, j.state) for j in judged.judgements if j.packet == "derived_power_w"] == [
        ("derived_power_w", State.WARNING)
    ]
    assert ground.value().state == "warning"
    ground.telemetry.limits.override("derived_power_w.power_w", Limits(critical=(None, 0.7)), 1, user="ann")
    ground.receive(supply_3v3_v=3.0, current_imager_ma=200)
    assert ground.value().state == "ok"
    ground.derived.change("power_w", request(expression=f"2 * {POWER}"), user="ann")
    ground.receive(supply_3v3_v=3.0, current_imager_ma=200)
    assert ground.value().state == "critical"


def test_a_parameter_that_cannot_be_computed_is_unknown_with_the_reason(ground: Ground) -> None:
    """After a division by zero, or with a missing or stale value, a parameter is unknown with the reason."""
    ground.derived.add(request("share", "1 / housekeeping.current_imager_ma"), user="ann")
    ground.derived.add(request("both", "housekeeping.supply_3v3_v + timing.detect_ms"), user="ann")
    assert ground.value("share").text == "never"
    ground.receive(current_imager_ma=0, supply_3v3_v=3.0)
    assert (ground.value("share").value, ground.value("share").text) == (None, "unknown: division by zero")
    assert ground.value("both").text == "unknown: timing.detect_ms has no current value"
    ground.receive("timing", detect_ms=2.0)
    assert ground.value("both").value == pytest.approx(5.0)
    ground.clock.forward(3600)
    ground.receive("timing", detect_ms=2.0)
    assert ground.value("both").text == "unknown: housekeeping.supply_3v3_v has no current value"
    assert ground.plotted("both") == [None, 5.0, None]


def test_the_past_is_recomputed_as_a_job(ground: Ground) -> None:
    """A job computes the parameter from packets received before its definition. After a change of the definition, a job
    replaces the stored values of its span."""
    for hour in range(3):
        for _ in range(3):
            ground.receive(supply_3v3_v=3.0, current_imager_ma=100 * (hour + 1))
        ground.clock.forward(3600)
    ground.derived.add(request(), user="ann")
    assert ground.plotted() == []
    start = ground.clock() - timedelta(days=1)
    job = ground.history.recompute("power_w", start, ground.clock(), user="ann")
    wait(ground, job.id)
    assert ground.jobs.get(job.id).result == {"values": 9, "unknown": 0}
    assert ground.plotted() == pytest.approx([0.3] * 3 + [0.6] * 3 + [0.9] * 3)
    ground.telemetry.rollups.make()
    ground.derived.change("power_w", request(expression=f"10 * {POWER}"), user="ann")
    second_job = ground.history.recompute("power_w", start, ground.clock() - timedelta(hours=2, minutes=30), user="ann")
    wait(ground, second_job.id)
    assert ground.plotted() == pytest.approx([3.0] * 3 + [0.6] * 3 + [0.9] * 3)


def test_recomputation_gives_the_values_computed_on_reception(ground: Ground) -> None:
    """Recomputed rows equal those computed on reception, also with two packets of which one becomes stale."""
    ground.derived.add(request("both", "housekeeping.supply_3v3_v > timing.detect_ms"), user="ann")
    for k in range(40):
        ground.receive("timing" if k % 7 == 3 else "housekeeping", supply_3v3_v=3.0 + k, detect_ms=20.0)
    before = ground.telemetry.archive.packets("derived_both", None, None, 100, None)
    job = ground.history.recompute("both", ground.clock() - timedelta(days=1), ground.clock() + timedelta(1), user="a")
    wait(ground, job.id)
    after = ground.telemetry.archive.packets("derived_both", None, None, 100, None)

    def content(rows: list[Any]) -> list[Any]:
        return sorted((row.received, str(row.values), row.device_time_s) for row in rows)

    assert len(before) == 40
    assert content(after) == content(before)


def test_recomputation_uses_the_last_packet_of_a_kind_that_does_not_become_stale(ground: Ground) -> None:
    """A packet without a limit of age is current until the next one, also if it was received hours before."""
    ground.derived.add(request("rate", "housekeeping.supply_3v3_v * frame_info.exposure_ms", unit=""), user="ann")
    ground.receive("frame_info", exposure_ms=100)
    for _ in range(3):
        for _ in range(4):
            ground.receive(supply_3v3_v=3.0)
            ground.clock.forward(60)
        ground.clock.forward(3600)
    before = ground.plotted("rate")
    assert before.count(300.0) == 12
    job = ground.history.recompute("rate", ground.clock() - timedelta(days=1), ground.clock(), user="ann")
    wait(ground, job.id)
    assert ground.plotted("rate") == before


def exported(ground: Ground, key: str, file_format: str) -> bytes:
    """Return the exported file of one field."""
    span = ground.clock() - timedelta(hours=1), ground.clock() + timedelta(hours=1)
    return b"".join(export(ground.telemetry.archive, [key], *span, form="converted", file_format=file_format))


def test_exports_keep_the_values_of_an_earlier_type(ground: Ground, database: Any, tmp_path: Path) -> None:
    """If a parameter changes from a number to yes/no, exports have the type of the new definition, and the numbers
    unchanged: in CSV in the column itself, in Parquet and HDF5 as JSON in another column."""
    expressions = ["housekeeping.supply_3v3_v", "housekeeping.supply_3v3_v > 3"]
    ground.derived.add(request(expression=expressions[0]), user="ann")
    ground.receive(supply_3v3_v=3.25)
    ground.derived.change("power_w", request(expression=expressions[1]), user="ann")
    ground.receive(supply_3v3_v=3.5)
    key = "derived_power_w.power_w"
    assert [line.split(b",")[-1] for line in exported(ground, key, "csv").split()] == [key.encode(), b"3.25", b"true"]
    table = pq.read_table(io.BytesIO(exported(ground, key, "parquet")))
    assert (table[key].to_pylist(), table["other_values"].to_pylist()) == ([None, True], [f'{{"{key}":3.25}}', None])
    with h5py.File(io.BytesIO(exported(ground, key, "hdf5"))) as file:
        group = file["derived_power_w"]
        assert group["power_w"][:].tolist() == [-1, 1]
        assert group["other_values"].asstr()[:].tolist() == [f'{{"{key}":3.25}}', ""]
    export_parquet(database, ground.derived, tmp_path / "out")
    table = ds.dataset(tmp_path / "out" / "telemetry" / "packet=derived_power_w", partitioning="hive").to_table()
    assert (table["power_w"].to_pylist(), table["other_values"].to_pylist()) == (
        [None, True],
        ['{"power_w":3.25}', None],
    )
    ground.derived.change("power_w", request(expression=expressions[0]), user="ann")
    table = pq.read_table(io.BytesIO(exported(ground, key, "parquet")))
    assert (table[key].to_pylist(), table["other_values"].to_pylist()) == ([3.25, 1.0], [None, None])


def test_invalid_definitions_are_rejected(ground: Ground) -> None:
    """An invalid definition is rejected with the reason and not stored."""
    for invalid, words in [
        (request("Power"), "name of the derived parameter is invalid"),
        (request(expression="housekeeping.nothing"), "unknown telemetry field"),
        (request(expression="1 + 1"), "refers to no telemetry field"),
        (request(expression="housekeeping.mode"), "result of the expression is text"),
        (request(expression="housekeeping.supply_3v3_v +"), "position 28"),
        (request(watch=[2.0, 1.0]), "limits are empty"),
    ]:
        with pytest.raises(BadInput, match=words):
            ground.derived.add(invalid, user="ann")
    assert ground.derived.list_all() == []
    ground.derived.add(request(), user="ann")
    with pytest.raises(Conflict, match="exists"):
        ground.derived.add(request(), user="ann")
    with pytest.raises(BadInput, match="cannot be changed"):
        ground.derived.change("power_w", request("other"), user="ann")
    with pytest.raises(NotFound):
        ground.history.recompute("other", ground.clock() - timedelta(1), ground.clock(), user="ann")
    with pytest.raises(BadInput, match="time span"):
        ground.history.recompute("power_w", ground.clock(), ground.clock(), user="ann")


def test_a_deleted_parameter_leaves_the_page_and_keeps_its_history(ground: Ground, database: Any, bus: Any) -> None:
    """A deleted parameter is not listed. When it is defined again, its history is available. Another server process reads
    a new definition on request."""
    other = TelemetryService(
        DICTIONARY, database, bus, ground.clock, lambda: None, lambda: True, default_roles(DICTIONARY).quantities.status
    )
    ground.derived.add(request(), user="ann")
    ground.receive(supply_3v3_v=3.0, current_imager_ma=100)
    span = ground.clock() - timedelta(hours=1), ground.clock() + timedelta(hours=1)
    assert other.archive.history(["derived_power_w.power_w"], *span, 100)[0].y == pytest.approx([0.3])
    ground.derived.delete("power_w", user="ann")
    assert not [v for v in ground.telemetry.values() if v.name == "power_w"]
    with pytest.raises(NotFound):
        ground.plotted()
    ground.derived.add(request(), user="ann")
    assert ground.plotted() == pytest.approx([0.3])


def wait(ground: Ground, job_id: int) -> None:
    """Wait until a job has ended."""
    import time

    limit_s = time.monotonic() + 60
    while ground.jobs.get(job_id).state not in ("done", "failed"):
        assert time.monotonic() < limit_s
        time.sleep(0.01)
    assert ground.jobs.get(job_id).state == "done", ground.jobs.get(job_id).text

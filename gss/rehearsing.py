"""The process of a rehearsal: all services on a temporary store, with a stepped clock and a line to a simulated unit only."""

from __future__ import annotations

from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

from gss import garbage
from gss.instruments.registry import Registry
from gss.operations.clock import stopwatch_s
from gss.operations.passes.plan_runner import EARLY
from gss.operations.rehearsals.director import Director, Ground
from gss.operations.rehearsals.rehearsal_report import RehearsalReport
from gss.operations.rehearsals.rehearsals import ORDER, ORDER_FILE, RehearsalOrder
from gss.operations.rehearsals.stepped import RehearsalLine, SteppedClock, stepped_unit
from gss.settings import Settings
from gss.store import passes as store
from gss.store.engine import Database, open_engine
from gss.store.models import PassPlan, Station
from gss.wiring.build import build
from gss.wiring.services import Services

LEAD = timedelta(seconds=10)
"""Time from the start of the rehearsal to the earliest time at which a signal belongs to the pass."""


def rehearse(folder: Path, report: Callable[[float, str], None]) -> RehearsalReport:
    """Rehearse the plan in a prepared folder. Raises GssError."""
    order: RehearsalOrder = ORDER.validate_json((folder / ORDER_FILE).read_bytes())
    settings = Settings(
        data=folder,
        database="",
        accounts="",
        blobs="",
        device="",
        units="",
        simulator="",
        link_keys="",
        notifications="",
        cluster="",
        instrument=order.instrument,
        packages=order.packages,
        framing=order.framing,
        auto_download=order.auto_download,
    )
    plan, station = _plan(settings, order.plan_id)
    registry, options = Registry(settings.instruments_folder), order.options
    faults = ["--bit-error-rate", str(options.bit_error_rate), "--drop-rate", str(options.drop_rate)]
    instrument = registry.get(order.instrument)
    clock = SteppedClock(plan.rise - EARLY - LEAD)
    with stepped_unit(
        registry.folder(order.instrument),
        instrument.link,
        folder / "unit",
        station.line_baud,
        options.seed,
        [*faults, *(["--framing", order.framing] if order.framing else [])],
    ) as unit:
        line = RehearsalLine(unit.stream)
        services = build(settings, clock=clock.clock, open_line=line.open)
        garbage.collect_as_usual()
        passes = services.passes
        ground = Ground(
            services.line.link,
            passes.plans,
            passes.runner,
            passes.stations,
            passes.spacecraft,
            services.procedures.runs,
            services.transfers.writer,
            (services.telemetry.alarms.tick, passes.runner.tick),
            stopwatch_s,
        )
        _start(services)
        try:
            return Director(ground, clock, line, unit, options).run(order.plan_id, report)
        finally:
            line.end()
            services.stop()


def _start(services: Services) -> None:
    """Start the services that execute plans. The rehearsal itself calls the functions that run once a second, and runs
    the steps of procedures."""
    services.transfers.transfers.start()
    services.commanding.commands.start()
    services.passes.runner.start()
    services.telemetry.alarms.start()
    services.dispatcher.start()
    services.line.link.start()


def _plan(settings: Settings, plan_id: int) -> tuple[PassPlan, Station]:
    database = Database(open_engine(settings.database_url))
    try:
        with database.unit_of_work() as session:
            plan = store.get_plan(session, plan_id)
            return plan, store.get_station(session, plan.station_id)
    finally:
        database.close()

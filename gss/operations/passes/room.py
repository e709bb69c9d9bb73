"""The services of this room, as routers and commands use them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gss.operations.catalogues.build_catalogue import CatalogueService
from gss.operations.clock import Now
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.stack_runs import StackRunner
from gss.operations.commanding.stacks import StackService
from gss.operations.events import EventBus
from gss.operations.line.link import LinkService
from gss.operations.passes.line_budget import LineBudgetService
from gss.operations.passes.pass_table import PassService
from gss.operations.passes.plan_items import ItemControl
from gss.operations.passes.plan_runner import PlanRunner
from gss.operations.passes.plans import PlanService
from gss.operations.passes.spacecraft import SpacecraftService
from gss.operations.passes.stations import StationService
from gss.operations.procedures.procedures import ProcedureService
from gss.operations.procedures.runs import ProcedureRunner
from gss.operations.transfers.downloads import Downloads
from gss.operations.transfers.transfers import TransferService
from gss.store.engine import Database


@dataclass(frozen=True)
class Passes:
    """Orbit, stations, passes and plans. ``now``: the server's clock."""

    spacecraft: SpacecraftService
    stations: StationService
    table: PassService
    plans: PlanService
    runner: PlanRunner
    now: Now


def open_passes(
    database: Database,
    bus: EventBus,
    now: Now,
    link: LinkService,
    commands: CommandService,
    procedures: ProcedureService,
    procedure_runs: ProcedureRunner,
    stacks: StackService,
    runs: StackRunner,
    downloads: Downloads,
    transfers: TransferService,
    catalogues: CatalogueService,
    permits: Callable[[str, str], None],
) -> Passes:
    """Create the services."""
    spacecraft, stations = SpacecraftService(database, bus, now), StationService(database, bus, now)
    table = PassService(spacecraft, stations, LineBudgetService(link, database), now)
    control = ItemControl(procedures, procedure_runs, stacks, runs, downloads, transfers, catalogues, permits)
    plans = PlanService(table, spacecraft, control, commands, database, bus, now)
    runner = PlanRunner(plans, control, table, link, commands, bus, now)
    return Passes(spacecraft, stations, table, plans, runner, now)

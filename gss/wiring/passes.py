"""Services of the orbit, ground stations, passes and pass plans."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from gss.operations.frames.attitude_exchange import AttitudeExchange
from gss.operations.frames.place import PlaceService
from gss.operations.passes.line_budget import LineBudgetService
from gss.operations.passes.pass_table import PassService
from gss.operations.passes.plan_items import ItemControl
from gss.operations.passes.plan_runner import PlanRunner
from gss.operations.passes.plans import PlanService
from gss.operations.passes.spacecraft import SpacecraftService
from gss.operations.passes.stations import StationService
from gss.operations.rehearsals.rehearsals import RehearsalService
from gss.wiring.accounts import Accounts
from gss.wiring.base import BaseServices
from gss.wiring.catalogues import Catalogues
from gss.wiring.commanding import Commanding
from gss.wiring.frames import Frames
from gss.wiring.line import Line
from gss.wiring.procedures import Procedures
from gss.wiring.transfers import Transfers


@dataclass(frozen=True)
class Passes:
    """Services of the orbit, ground stations, passes and plans. ``place``: position of the camera, from the orbit or the sensor.
    ``attitudes``: export and import of messages with attitudes of the camera."""

    spacecraft: SpacecraftService
    stations: StationService
    table: PassService
    plans: PlanService
    runner: PlanRunner
    place: PlaceService
    rehearsals: RehearsalService
    attitudes: AttitudeExchange


def open_passes(
    base: BaseServices,
    line: Line,
    accounts: Accounts,
    commanding: Commanding,
    procedures: Procedures,
    transfers: Transfers,
    frames: Frames,
    catalogues: Catalogues,
) -> Passes:
    """Create the pass services."""
    database, bus, now, link, commands = base.database, base.bus, base.clock.now, line.link, commanding.commands
    spacecraft, stations = SpacecraftService(database, bus, now), StationService(database, bus, now)
    table = PassService(spacecraft, stations, LineBudgetService(link, database), now)
    control = ItemControl(
        procedures.procedures,
        procedures.runs,
        frames.downloads,
        transfers.transfers,
        catalogues.catalogues,
        accounts.accounts.require,
    )
    plans = PlanService(table, spacecraft, control, commands, database, bus, now)
    runner = PlanRunner(plans, control, table, link, commands, bus, now)
    place = PlaceService(
        base.unit.roles.operations,
        database,
        transfers.bank_history,
        commanding.schedule.clock,
        spacecraft.orbit_at,
    )
    settings = base.settings
    rehearsals = RehearsalService(
        database,
        base.blobs,
        base.jobs,
        plans,
        settings.data / "rehearsals",
        base.unit.name,
        settings.instruments_folder,
        settings.framing,
        settings.auto_download,
        now,
    )
    attitudes = AttitudeExchange(database, base.parsing, base.unit.name, partial(spacecraft.name, base.unit.name), now)
    return Passes(spacecraft, stations, table, plans, runner, place, rehearsals, attitudes)

"""Services of procedures."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.procedures.conditions import Conditions
from gss.operations.procedures.procedures import ProcedureService
from gss.operations.procedures.runs import ProcedureRunner
from gss.wiring.base import BaseServices
from gss.wiring.commanding import Commanding
from gss.wiring.line import Line
from gss.wiring.telemetry import TelemetryServices


@dataclass(frozen=True)
class Procedures:
    """Services of procedures and their runs."""

    procedures: ProcedureService
    runs: ProcedureRunner


def open_procedures(base: BaseServices, line: Line, commanding: Commanding, telemetry: TelemetryServices) -> Procedures:
    """Create the procedure services."""
    database, now = base.database, base.clock.now
    procedures = ProcedureService(line.link, base.unit, telemetry.telemetry.derived, database, now)
    conditions = Conditions(telemetry.telemetry)
    runs = ProcedureRunner(procedures, conditions, line.link, commanding.commands, database, base.bus, now)
    return Procedures(procedures, runs)

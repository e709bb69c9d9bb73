"""Services of telemetry, its limits and alarms."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.derived_history import DerivedHistory
from gss.operations.telemetry.last_attitude import LastAttitude
from gss.operations.telemetry.telemetry import TelemetryService
from gss.wiring.base import BaseServices
from gss.wiring.commanding import Commanding
from gss.wiring.line import Line


@dataclass(frozen=True)
class TelemetryServices:
    """Services of telemetry, derived parameters, alarms, and the latest attitude of the sensor."""

    telemetry: TelemetryService
    derived_history: DerivedHistory
    last_attitude: LastAttitude
    alarms: AlarmService


def open_telemetry(base: BaseServices, line: Line, commanding: Commanding) -> TelemetryServices:
    """Create the telemetry services."""
    database, bus, link = base.database, base.bus, line.link
    quantities = base.unit.roles.quantities
    telemetry = TelemetryService(
        base.dictionary,
        database,
        bus,
        base.clock.now,
        lambda: link.contact_id,
        base.disk.has_room_for_rows,
        quantities.status,
    )
    return TelemetryServices(
        telemetry,
        DerivedHistory(telemetry.derived, database, base.jobs, base.clock.now),
        LastAttitude(quantities.attitude, base.clock.monotonic_s, commanding.schedule.clock),
        AlarmService(telemetry.derived, telemetry, link, database, bus, base.clock.now),
    )

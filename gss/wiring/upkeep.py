"""Maintenance services: retention, backups, health, and the tasks that run once a second."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.clock import utc_now
from gss.operations.frames.ground_attitude import GroundAttitude
from gss.operations.frames.margins import MarginWatch
from gss.operations.line.dispatcher import Dispatcher
from gss.operations.metrics import Metrics, StreamCounts
from gss.operations.passes.next_pass import NextPassWatch
from gss.operations.transfers.expiry import ExpiryWatch
from gss.operations.upkeep.audit_watch import AuditWatch
from gss.operations.upkeep.backup import BackupService
from gss.operations.upkeep.check_store import CheckStoreService
from gss.operations.upkeep.clocks import ClockWatch
from gss.operations.upkeep.disk import BackupDisk, DiskWatch
from gss.operations.upkeep.forecast import ForecastService
from gss.operations.upkeep.installation_health import HealthService
from gss.operations.upkeep.page_check import PageCheck
from gss.operations.upkeep.retention import RetentionService
from gss.operations.upkeep.retention_watch import DailyRetention, RetentionWatch
from gss.operations.upkeep.status import StatusService
from gss.wiring.accounts import Accounts
from gss.wiring.base import BaseServices
from gss.wiring.commanding import Commanding
from gss.wiring.frames import Frames
from gss.wiring.line import Line
from gss.wiring.passes import Passes
from gss.wiring.telemetry import TelemetryServices
from gss.wiring.transfers import Transfers


@dataclass(frozen=True)
class Upkeep:
    """Maintenance services. ``streams``: counts of the event streams. ``status``: service that runs once a second."""

    retention: RetentionService
    backups: BackupService
    check: CheckStoreService
    forecast: ForecastService
    health: HealthService
    metrics: Metrics
    streams: StreamCounts
    clocks: ClockWatch
    pages: PageCheck
    audit: AuditWatch
    status: StatusService


def open_retention(base: BaseServices, line: Line) -> RetentionService:
    """Create the service that removes expired data. It is separate from ``open_upkeep`` because the contact services need it."""
    share = base.settings.retention_share_percent / 100
    return RetentionService(
        base.database, base.blobs, base.jobs, base.bus, line.link, base.upkeep_lock, utc_now, base.trust, share
    )


def open_upkeep(
    base: BaseServices,
    line: Line,
    accounts: Accounts,
    telemetry: TelemetryServices,
    commanding: Commanding,
    transfers: Transfers,
    frames: Frames,
    retention: RetentionService,
    dispatcher: Dispatcher,
    passes: Passes,
) -> Upkeep:
    """Create the maintenance services."""
    settings, database, blobs, bus, now = base.settings, base.database, base.blobs, base.bus, base.clock.now
    disk, jobs, captures, trust, link = base.disk, base.jobs, base.captures, base.trust, line.link
    alarms, folder, schedule = telemetry.alarms, settings.backups_folder, commanding.schedule
    backups = BackupService(
        database,
        settings.database_url,
        blobs,
        captures,
        settings.instruments_folder,
        folder,
        base.upkeep_lock,
        BackupDisk(folder, disk.watch_bytes, disk.stop_bytes),
        jobs,
        bus,
        utc_now,
        trust,
    )
    pages, streams, watch = PageCheck(database, bus), StreamCounts(), AuditWatch(accounts.audit, alarms)
    clocks = ClockWatch(bus, now, base.clock.monotonic_s, [alarms.clock_jumped, schedule.clock_jumped])
    health = HealthService(
        database,
        disk,
        blobs,
        captures,
        link,
        telemetry.telemetry,
        frames.frames,
        frames.compiler,
        jobs,
        backups,
        clocks,
        pages,
        watch,
        dispatcher,
        streams,
        now,
        base.clock.monotonic_s,
    )
    tickers = [
        clocks.tick,
        alarms.tick,
        ExpiryWatch(transfers.bank_history, alarms, now, settings.catalogue_watch_days).tick,
        MarginWatch(telemetry.last_attitude, passes.place.at, alarms, now).tick,
        link.watch,
        DiskWatch(disk, alarms, link, telemetry.telemetry).tick,
        RetentionWatch(trust, retention, alarms).tick,
        DailyRetention(retention, clocks, trust, utc_now).tick,
        telemetry.telemetry.tick,
        passes.runner.tick,
    ]
    status = StatusService(
        link,
        transfers.banks,
        alarms,
        bus,
        now,
        commanding.authority,
        telemetry.last_attitude,
        GroundAttitude(database, bus, schedule.clock),
        NextPassWatch(passes.spacecraft, passes.stations, passes.table, now).report,
        base.unit.about.tried_on_hardware,
        tickers,
    )
    return Upkeep(
        retention,
        backups,
        CheckStoreService(database, blobs, captures, jobs, accounts.audit),
        ForecastService(database, retention, disk, backups.folder),
        health,
        Metrics([health.samples, transfers.writer.samples, dispatcher.samples]),
        streams,
        clocks,
        pages,
        watch,
        status,
    )

"""One function per room of operations: creates its services from those of the rooms below it. Used by the wiring alone."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.device.driver import open_driver
from gss.device.link_keys import packet_signer
from gss.domain.stars import StarTable
from gss.instruments.dictionary.definitions import Dictionary
from gss.instruments.package import Instrument
from gss.instruments.registry import Registry
from gss.operations.accounts.accounts import AccountService
from gss.operations.accounts.audit import AuditService
from gss.operations.clock import Clock, monotonic_s, stopwatch_s, utc_now, utc_us
from gss.operations.commanding.abort_journal import AbortJournal
from gss.operations.commanding.authority import AuthorityService
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.schedule import ScheduleService
from gss.operations.commanding.stack_runs import StackRunner
from gss.operations.commanding.stacks import StackService
from gss.operations.events import EventBus
from gss.operations.folder_lock import own_folder
from gss.operations.frames.dark_frames import DarkFrames
from gss.operations.frames.frames import FrameService
from gss.operations.frames.margins import MarginWatch
from gss.operations.frames.place import PlaceService
from gss.operations.frames.replay import ReplayService
from gss.operations.frames.solve import Solver
from gss.operations.frames.solver_cache import SolverCache
from gss.operations.intake.bank_intake import BankIntake
from gss.operations.intake.frame_intake import FrameIntake
from gss.operations.intake.frame_records import FrameRecords
from gss.operations.intake.result_intake import ResultIntake
from gss.operations.intake.sensor_knowledge import SensorKnowledge
from gss.operations.intake.uploaded_images import UploadedImages
from gss.operations.jobs import JobService
from gss.operations.line.dispatcher import Dispatcher, LineEventQueue, Subscriber
from gss.operations.line.link import LinkService, OpenLine
from gss.operations.line.raw_capture import Retention
from gss.operations.metrics import Metrics, StreamCounts
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.operations.passes.room import Passes
from gss.operations.procedures.conditions import Conditions
from gss.operations.procedures.procedures import ProcedureService
from gss.operations.procedures.runs import ProcedureRunner
from gss.operations.studies.camera_book import CameraBook
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.last_attitude import LastAttitude
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.transfers.arrivals import Writer
from gss.operations.transfers.bank_history import BankHistoryService
from gss.operations.transfers.bank_plans import activations, uploads
from gss.operations.transfers.banks import BankService
from gss.operations.transfers.device_tables import DeviceTableService
from gss.operations.transfers.expiry import ExpiryWatch
from gss.operations.transfers.flash_banks import FlashBanks
from gss.operations.transfers.transfer_parts import PartStore
from gss.operations.transfers.transfer_progress import TransferProgress
from gss.operations.transfers.transfers import TransferService
from gss.operations.upkeep.audit_watch import AuditWatch
from gss.operations.upkeep.backup import BackupService
from gss.operations.upkeep.check_store import CheckStoreService
from gss.operations.upkeep.clock_trust import ClockTrust
from gss.operations.upkeep.clocks import ClockWatch
from gss.operations.upkeep.disk import DiskGuard, DiskWatch
from gss.operations.upkeep.health import HealthService
from gss.operations.upkeep.page_check import PageCheck
from gss.operations.upkeep.retention import DailyRetention, RetentionService
from gss.operations.upkeep.retention_watch import RetentionWatch
from gss.operations.upkeep.status import StatusService
from gss.operations.upkeep.upkeep import Upkeep
from gss.settings import Settings
from gss.store.blobs import BlobStore
from gss.store.engine import Database, migrate, open_engine


@dataclass(frozen=True)
class BaseServices:
    """What every room needs. ``clock``: mission time; ``unit``: instrument of the unit on the line."""

    settings: Settings
    clock: Clock
    database: Database
    blobs: BlobStore
    bus: EventBus
    trust: ClockTrust
    disk: DiskGuard
    jobs: JobService
    parsing: ParseProcesses
    stars: StarTable
    instruments: Registry
    unit: Instrument

    @property
    def dictionary(self) -> Dictionary:
        """Dictionary of the unit on the line."""
        return self.unit.dictionary

    @property
    def framing(self) -> str:
        """Framing of the line: as set, else the instrument's."""
        return self.settings.framing or self.unit.link.framing

    def version_of(self, name: str) -> str | None:
        """Version of an instrument in use: the unit's as it was loaded at the start, another's as it is installed; None:
        unknown."""
        return self.unit.version if name == self.unit.name else self.instruments.version_of(name)

    @property
    def captures(self) -> Path:
        """Folder of the raw captures."""
        return self.settings.data / "captures"

    @property
    def upkeep_lock(self) -> Path:
        """Held by a backup or a removal, so that they do not overlap."""
        return self.settings.data / "upkeep.lock"


@dataclass(frozen=True)
class Commanding:
    """Services that send commands."""

    authority: AuthorityService
    commands: CommandService
    schedule: ScheduleService
    stacks: StackService
    stack_runs: StackRunner


@dataclass(frozen=True)
class Procedures:
    """Procedures and their runs."""

    procedures: ProcedureService
    runs: ProcedureRunner


@dataclass(frozen=True)
class Transfers:
    """Services that move content, and the thread that stores it."""

    writer: Writer
    progress: TransferProgress
    transfers: TransferService
    flash: FlashBanks
    tables: DeviceTableService
    banks: BankService
    bank_history: BankHistoryService


@dataclass(frozen=True)
class Frames:
    """Services that store and solve frames. ``epoch_jyear``: of the star positions."""

    book: CameraBook
    darks: DarkFrames
    solver: Solver
    epoch_jyear: float
    frames: FrameService
    replay: ReplayService


def open_base(settings: Settings, clock: Clock, *, ready: bool) -> BaseServices:
    """Open the stores and create what every room needs."""
    own_folder(settings.data)
    if not ready:
        migrate(settings.database_url)
    database = Database(open_engine(settings.database_url))
    blobs = BlobStore(settings.blobs_url)
    bus = EventBus(database, clock.now)
    trust = ClockTrust(database, bus, utc_now, timedelta(days=settings.retention_pause_days))
    if not ready:
        trust.start()
    disk = DiskGuard(settings.data, settings.disk_watch_mb << 20, settings.disk_stop_mb << 20)
    jobs = JobService(database, bus, utc_now, disk.check)
    parsing, stars = ParseProcesses(), load_stars()
    instruments = Registry(settings.instruments_folder)
    unit = instruments.get(settings.unit_instrument)
    return BaseServices(settings, clock, database, blobs, bus, trust, disk, jobs, parsing, stars, instruments, unit)


def open_link(base: BaseServices, events: LineEventQueue, open_line: OpenLine | None) -> LinkService:
    """Create the link, which owns the port. ``open_line``: None for real ports."""
    settings = base.settings
    retention = Retention(settings.capture_file_mb << 20, settings.capture_keep_mb << 20)
    signer = packet_signer(Path(settings.link_keys), utc_us) if settings.link_keys else None
    return LinkService(
        base.dictionary,
        base.unit.roles,
        base.database,
        base.bus,
        base.captures,
        base.clock.now,
        base.clock.monotonic_s,
        events,
        open_driver(base.unit, settings.framing, signer),
        retention,
        base.unit.link,
        base.version_of,
        settings.device if settings.simulator else "",
        open_line,
    )


def open_commanding(base: BaseServices, link: LinkService, accounts: AccountService) -> Commanding:
    """Create the room that sends commands."""
    database, bus, now = base.database, base.bus, base.clock.now
    authority = AuthorityService(database, bus, now)
    journal = AbortJournal(base.settings.data / "aborts.jsonl")
    commands = CommandService(link, database, bus, now, authority, accounts.require, journal)
    stacks = StackService(link, commands, database, now)
    runs = StackRunner(stacks, link, commands, database, bus, now, base.clock.monotonic_s)
    return Commanding(authority, commands, ScheduleService(link, commands, bus, now), stacks, runs)


def open_procedures(
    base: BaseServices, link: LinkService, commands: CommandService, telemetry: TelemetryService
) -> Procedures:
    """Create the room that runs procedures."""
    procedures = ProcedureService(link, base.unit, telemetry.derived, base.database, base.clock.now)
    conditions = Conditions(telemetry)
    return Procedures(
        procedures, ProcedureRunner(procedures, conditions, link, commands, base.database, base.bus, base.clock.now)
    )


def open_transfers(base: BaseServices, link: LinkService, schedule: ScheduleService) -> Transfers:
    """Create the room that moves content to and from the device."""
    database, blobs, bus, stars = base.database, base.blobs, base.bus, base.stars
    now = base.clock.now
    writer, parts = Writer(monotonic_s, bus), PartStore(base.settings.data / "parts")
    progress = TransferProgress(link, database, bus, now, parts, writer)
    transfers = TransferService(link, database, bus, now, blobs, parts, writer, progress, base.disk.check)
    flash = FlashBanks(link)
    tables = DeviceTableService(link, flash, transfers, database, blobs, bus, stars, now, base.instruments)
    banks = BankService(flash, database, blobs, bus, stars, now, base.instruments)
    planners = [uploads(transfers, database), activations(schedule, base.unit.roles.operations)]
    history = BankHistoryService(link, database, now, planners)
    return Transfers(writer, progress, transfers, flash, tables, banks, history)


def open_frames(base: BaseServices, transfers: Transfers) -> Frames:
    """Create the room that stores and solves frames."""
    database, blobs, now = base.database, base.blobs, base.clock.now
    epoch_jyear = jyear_of(now())
    book, darks = CameraBook(database, base.instruments, now), DarkFrames(blobs)
    cache = SolverCache(base.stars, folder=base.settings.data / "figures")
    solver = Solver(book.profile, cache, stopwatch_s, epoch_jyear=epoch_jyear, dark=darks.pattern)
    # Judged and drawn with the stars where they are now: at the catalogue's epoch a star at the frame's edge may lie outside.
    epoch_stars, chain = cache.stars(epoch_jyear), base.settings.solve_chain
    frames = FrameService(
        database, blobs, base.bus, solver, epoch_stars, now, chain, base.parsing, base.disk.check, base.instruments
    )
    replay = ReplayService(frames, transfers.banks, transfers.tables, base.instruments, stopwatch_s)
    return Frames(book, darks, solver, epoch_jyear, frames, replay)


def open_intake(
    base: BaseServices,
    link: LinkService,
    telemetry: TelemetryService,
    commanding: Commanding,
    transfers: Transfers,
    frames: Frames,
    images: UploadedImages,
) -> list[Subscriber]:
    """Create the services that store what the device sends without a request; return their event handlers in order."""
    bus, knowledge = base.bus, SensorKnowledge(base.unit.roles.operations)
    records = FrameRecords(link, transfers.tables, frames.frames, frames.replay)
    frame_intake = FrameIntake(
        link,
        telemetry,
        transfers.transfers,
        frames.frames,
        images,
        records,
        transfers.writer,
        commanding.schedule.clock,
        bus,
        base.clock.now,
        automatic=base.settings.auto_download,
    )
    result_intake = ResultIntake(base.unit.roles.quantities, records, transfers.banks, knowledge, base.stars)
    bank_intake = BankIntake(
        link,
        transfers.flash,
        transfers.banks,
        transfers.tables,
        transfers.transfers,
        commanding.commands,
        transfers.writer,
        bus,
    )
    return [frame_intake.handle, result_intake.handle, bank_intake.handle]


def open_upkeep(
    base: BaseServices,
    link: LinkService,
    telemetry: TelemetryService,
    frames: FrameService,
    writer: Writer,
    removal: RetentionService,
    clocks: ClockWatch,
    dispatcher: Dispatcher,
    streams: StreamCounts,
    alarms: AlarmService,
    audit: AuditService,
) -> Upkeep:
    """Create the maintenance services."""
    settings, database, blobs, bus = base.settings, base.database, base.blobs, base.bus
    disk, jobs, captures, trust = base.disk, base.jobs, base.captures, base.trust
    folder, url, lock = settings.backups_folder, settings.database_url, base.upkeep_lock
    backups = BackupService(database, url, blobs, captures, folder, lock, disk, jobs, bus, utc_now, trust)
    pages, check = PageCheck(database, bus), CheckStoreService(database, blobs, captures, jobs, audit)
    watch = AuditWatch(audit, alarms)
    health = HealthService(
        database,
        disk,
        blobs,
        captures,
        link,
        telemetry,
        frames,
        jobs,
        backups,
        clocks,
        pages,
        watch,
        dispatcher,
        streams,
        base.clock.now,
        base.clock.monotonic_s,
    )
    metrics = Metrics([health.samples, writer.samples, dispatcher.samples])
    return Upkeep(database, disk, removal, backups, check, health, metrics, clocks, trust, pages, watch)


def open_status(
    base: BaseServices,
    link: LinkService,
    telemetry: TelemetryService,
    alarms: AlarmService,
    authority: AuthorityService,
    attitude: LastAttitude,
    transfers: Transfers,
    removal: RetentionService,
    clocks: ClockWatch,
    passes: Passes,
    place: PlaceService,
) -> StatusService:
    """Create the service that runs once a second and publishes the header."""
    now = base.clock.now
    tickers = [
        clocks.tick,
        alarms.tick,
        ExpiryWatch(transfers.bank_history, alarms, now, base.settings.catalogue_watch_days).tick,
        MarginWatch(attitude, place.at, alarms, now).tick,
        link.watch,
        DiskWatch(base.disk, alarms, link, telemetry).tick,
        RetentionWatch(base.trust, removal, alarms).tick,
        DailyRetention(removal, clocks, base.trust, utc_now).tick,
        telemetry.tick,
        passes.runner.tick,
    ]
    tried = base.unit.about.tried_on_hardware
    return StatusService(link, transfers.banks, alarms, base.bus, now, authority, attitude, tried, tickers)

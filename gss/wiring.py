"""The only place where objects meet: settings in, everything connected, started and stopped in order."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any

from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.device.dictionary_file import load_dictionary
from gss.domain.stars import StarTable
from gss.operations.accounts.accounts import AccountService, open_accounts
from gss.operations.accounts.audit import AuditService
from gss.operations.catalogues.build_catalogue import CatalogueService
from gss.operations.catalogues.design import DesignService
from gss.operations.catalogues.star_lists import StarListService
from gss.operations.clock import monotonic_s, stopwatch_s, utc_now
from gss.operations.commanding.abort_journal import AbortJournal
from gss.operations.commanding.authority import AuthorityService
from gss.operations.commanding.command_history import CommandHistory
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.schedule import ScheduleService
from gss.operations.commanding.stack_runs import StackRunner
from gss.operations.commanding.stacks import StackService
from gss.operations.events import EventBus, StreamCounts
from gss.operations.folder_lock import own_folder
from gss.operations.frames.frames import FrameService
from gss.operations.frames.place import PlaceService
from gss.operations.frames.replay import ReplayService
from gss.operations.frames.rerun_viewer import RerunViewer
from gss.operations.frames.solve import Solver
from gss.operations.frames.solver_cache import SolverCache
from gss.operations.intake.bank_intake import BankIntake
from gss.operations.intake.frame_intake import FrameIntake
from gss.operations.intake.frame_records import FrameRecords
from gss.operations.intake.result_intake import ResultIntake
from gss.operations.intake.table_intake import TableIntake
from gss.operations.jobs import JobService
from gss.operations.line.contacts import ContactService
from gss.operations.line.dispatcher import Dispatcher
from gss.operations.line.line_events import LineEventQueue
from gss.operations.line.link import LinkService
from gss.operations.line.raw_capture import Retention
from gss.operations.line.replay_capture import CaptureReplay
from gss.operations.line.sensor_knowledge import SensorKnowledge
from gss.operations.line.status import StatusService
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.operations.recordings.live import LiveRecordings
from gss.operations.recordings.scope import Scopes
from gss.operations.recordings.stored import Recordings
from gss.operations.studies.analyses import AnalysisService
from gss.operations.studies.calibrations import CalibrationService
from gss.operations.studies.camera_book import CameraBook
from gss.operations.studies.campaigns import CampaignService
from gss.operations.studies.dark_frames import DarkFrames
from gss.operations.studies.dask_executor import make_executor
from gss.operations.studies.executor import Executor
from gss.operations.studies.night_frames import StoredShots
from gss.operations.studies.reprocess import WORKERS, ReprocessService
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.transfers.arrivals import Writer
from gss.operations.transfers.bank_history import BankHistoryService
from gss.operations.transfers.bank_plans import activations, uploads
from gss.operations.transfers.banks import BankService
from gss.operations.transfers.device_tables import DeviceTableService
from gss.operations.transfers.downloads import Downloads
from gss.operations.transfers.expiry import ExpiryWatch
from gss.operations.transfers.transfer_parts import PartStore
from gss.operations.transfers.transfers import TransferService
from gss.operations.transfers.uploaded_images import UploadedImages
from gss.operations.upkeep.backup import BackupService
from gss.operations.upkeep.check_store import CheckStoreService
from gss.operations.upkeep.clock_trust import ClockTrust
from gss.operations.upkeep.clocks import ClockWatch
from gss.operations.upkeep.disk import DiskGuard, DiskWatch
from gss.operations.upkeep.health import HealthService
from gss.operations.upkeep.metrics import Metrics
from gss.operations.upkeep.page_check import PageCheck
from gss.operations.upkeep.retention import DailyRetention, RetentionService
from gss.operations.upkeep.retention_watch import RetentionWatch
from gss.operations.upkeep.upkeep import Upkeep
from gss.settings import Settings
from gss.store.blobs import BlobStore
from gss.store.engine import Database, migrate, open_engine


@dataclass
class Services:
    """Everything a router may ask for."""

    settings: Settings
    stars: StarTable
    bus: EventBus
    link: LinkService
    commands: CommandService
    telemetry: TelemetryService
    transfers: TransferService
    frames: FrameService
    banks: BankService
    bank_history: BankHistoryService
    star_lists: StarListService
    catalogues: CatalogueService
    jobs: JobService
    status: StatusService
    viewer: RerunViewer
    database: Database
    replay: ReplayService
    alarms: AlarmService
    downloads: Downloads
    tables: DeviceTableService
    images: UploadedImages
    authority: AuthorityService
    history: CommandHistory
    schedule: ScheduleService
    stacks: StackService
    stack_runs: StackRunner
    campaigns: CampaignService
    reprocessing: ReprocessService
    executor: Executor
    contacts: ContactService
    dispatcher: Dispatcher
    writer: Writer
    capture_replay: CaptureReplay
    design: DesignService
    calibrations: CalibrationService
    analyses: AnalysisService
    place: PlaceService
    scopes: Scopes
    recordings: Recordings
    live_recordings: LiveRecordings
    accounts: AccountService
    audit: AuditService
    upkeep: Upkeep
    streams: StreamCounts
    parsing: ParseProcesses
    stopping: threading.Event = field(default_factory=threading.Event)
    workers: Callable[[], list[dict[str, Any]]] = list
    """Number, process, seconds since its start and restarts of each API worker; none where this process answers itself."""

    def start(self) -> None:
        """Settle what the last server left behind, then open the line."""
        self.jobs.start()
        self.transfers.start()
        self.commands.start()
        self.stack_runs.start()
        self.alarms.start()
        self.upkeep.retention.start()
        self.upkeep.pages.start()
        self.dispatcher.start()
        self.link.start()
        self.status.start()
        self.telemetry.rollups.start()
        if self.settings.device:
            self.link.open_later(self.settings.device)

    def announce_stop(self) -> None:
        """Interrupt the jobs and end the open streams and the parsing of files, so that the server need not cut them off. Runs in
        a signal handler: storing the jobs' state may wait for the database, so that a thread does it."""
        if not self.stopping.is_set():
            threading.Thread(target=self.jobs.interrupt, name="interrupt jobs", daemon=True).start()
        self.stopping.set()
        self.bus.wake_all()
        self.parsing.stop()

    def stop(self) -> None:
        """Close the line first, so that nothing new comes; then end what still works."""
        self.announce_stop()
        self.status.stop()
        self.stack_runs.shut_down()
        self.link.stop()
        self.dispatcher.stop()
        self.transfers.stop()
        self.capture_replay.stop()
        self.replay.stop()
        self.frames.stop()
        self.jobs.stop()
        self.telemetry.rollups.stop()
        self.executor.stop()
        self.database.close()


def build(settings: Settings, *, ready: bool = False) -> Services:
    """Connect everything; nothing runs yet. The database is brought to the newest schema, unless it is ``ready``: an API worker
    only reads what the link process has brought there."""
    own_folder(settings.data)
    if not ready:
        migrate(settings.database_url)
    database = Database(open_engine(settings.database_url))
    blobs = BlobStore(settings.blobs_url)
    bus = EventBus(database, utc_now)
    trust = ClockTrust(database, bus, utc_now, timedelta(days=settings.retention_pause_days))
    if not ready:
        trust.start()
    stars = load_stars()
    dictionary = load_dictionary()
    retention = Retention(settings.capture_file_mb << 20, settings.capture_keep_mb << 20)
    events = LineEventQueue(utc_now, monotonic_s)
    captures = settings.data / "captures"
    link = LinkService(dictionary, database, bus, captures, utc_now, monotonic_s, events, settings.framing, retention)
    authority = AuthorityService(database, bus, utc_now)
    accounts = open_accounts(database, settings, utc_now, monotonic_s)
    commands = CommandService(
        link, database, bus, utc_now, authority, accounts.require, AbortJournal(settings.data / "aborts.jsonl")
    )
    schedule = ScheduleService(link, commands, bus, utc_now)
    stacks = StackService(link, commands, database, utc_now)
    stack_runs = StackRunner(stacks, link, commands, database, bus, utc_now, monotonic_s)
    disk = DiskGuard(settings.data, settings.disk_watch_mb << 20, settings.disk_stop_mb << 20)
    telemetry = TelemetryService(dictionary, database, bus, utc_now, lambda: link.contact_id, disk.has_room_for_rows)
    alarms = AlarmService(dictionary, telemetry, link, database, bus, utc_now)
    jobs = JobService(database, bus, utc_now, disk.check)
    lock, share = settings.data / "upkeep.lock", settings.retention_share_percent / 100
    removal = RetentionService(database, blobs, jobs, bus, link, lock, utc_now, trust, share)
    contacts = ContactService(link, alarms, database, bus, captures, utc_now, removal.removed_before)
    capture_replay = CaptureReplay(dictionary, captures, telemetry.limits, bus, monotonic_s, settings.framing)
    writer, parts = Writer(monotonic_s, bus), PartStore(settings.data / "parts")
    transfers = TransferService(link, database, bus, utc_now, blobs, parts, writer, disk.check)
    tables = DeviceTableService(link, transfers, database, blobs, bus, stars, utc_now)
    book = CameraBook(database, utc_now)
    darks = DarkFrames(blobs)
    epoch_jyear, chain = jyear_of(utc_now()), settings.solve_chain
    solver = Solver(
        SolverCache(stars, folder=settings.data / "figures"),
        stopwatch_s,
        epoch_jyear=epoch_jyear,
        profiles=book.profile,
        dark=darks.pattern,
    )
    # Judged and drawn with the stars where they are now: at the catalogue's epoch a star at the frame's edge may lie outside.
    parsing = ParseProcesses()
    epoch_stars = solver.cache.stars(epoch_jyear)
    frames = FrameService(database, blobs, bus, solver, epoch_stars, utc_now, chain, parsing, disk.check)
    banks = BankService(database, blobs, bus, stars, utc_now)
    planners = [uploads(transfers, database), activations(schedule)]
    bank_history = BankHistoryService(link, database, utc_now, planners)
    executor = make_executor(settings.cluster, WORKERS)
    campaigns = CampaignService(database, jobs, executor if settings.cluster else None)
    reprocessing = ReprocessService(
        database, settings.blobs_url, jobs, utc_now, epoch_jyear, executor, chain, profiles=book.profiles
    )
    star_lists = StarListService(database, blobs, utc_now, parsing)
    catalogues = CatalogueService(database, blobs, jobs, transfers, banks, link, star_lists, stars, utc_now)
    replay = ReplayService(frames, banks, tables, stopwatch_s)
    images = UploadedImages(link, commands, transfers, frames, bus)
    records = FrameRecords(link, tables, frames, replay)
    frame_intake = FrameIntake(
        link, telemetry, transfers, frames, images, records, writer, schedule.clock, bus, utc_now
    )
    result_intake = ResultIntake(records, banks, SensorKnowledge(dictionary), stars)
    bank_intake = BankIntake(banks, transfers, commands, writer, bus)
    table_intake = TableIntake(tables, transfers, commands, writer, bus)
    dispatcher = Dispatcher(
        events,
        bus,
        monotonic_s,
        subscribers=[
            link.handle,
            telemetry.handle,
            commands.handle,
            transfers.handle,
            frame_intake.handle,
            result_intake.handle,
            bank_intake.handle,
            table_intake.handle,
            images.handle,
            bank_history.handle,
            alarms.handle,
            contacts.handle,
            schedule.handle,
            stack_runs.handle,
        ],
        periodic=[transfers.settle],
    )
    shots = StoredShots(database, frames)
    calibrations = CalibrationService(database, jobs, shots, solver, book, tables, bus, utc_now, darks)
    analyses = AnalysisService(database, jobs, shots, solver, book, contacts, bus, utc_now)
    viewer = RerunViewer(settings.data / "rerun-viewer")
    place = PlaceService(dictionary, database, bank_history, schedule.clock)
    recordings = Recordings(database, frames, stars, place.at)
    clocks = ClockWatch(bus, utc_now, monotonic_s, [alarms.clock_jumped, schedule.clock_jumped])
    folder, url = settings.backups_folder, settings.database_url
    backups = BackupService(database, url, blobs, captures, folder, lock, disk, jobs, bus, utc_now, trust)
    pages, streams = PageCheck(database, bus), StreamCounts()
    health = HealthService(
        database,
        disk,
        captures,
        link,
        telemetry,
        frames,
        jobs,
        backups,
        clocks,
        pages,
        dispatcher,
        streams,
        {
            "solve": lambda: frames.skipped,
            "line events": lambda: events.dropped,
            "stream": lambda: streams.dropped,
        },
        utc_now,
        monotonic_s,
    )
    metrics = Metrics([health.samples, writer.samples, dispatcher.samples])
    check = CheckStoreService(database, blobs, captures, jobs)
    upkeep = Upkeep(database, disk, removal, backups, check, health, metrics, clocks, trust, pages)
    status = StatusService(
        link,
        telemetry,
        banks,
        alarms,
        bus,
        utc_now,
        authority,
        tickers=[
            clocks.tick,
            alarms.tick,
            ExpiryWatch(bank_history, alarms, utc_now, settings.catalogue_watch_days).tick,
            link.watch,
            DiskWatch(disk, alarms, link, telemetry).tick,
            RetentionWatch(trust, removal, alarms).tick,
            DailyRetention(removal, clocks, trust, utc_now).tick,
        ],
    )
    return Services(
        settings,
        stars,
        bus,
        link,
        commands,
        telemetry,
        transfers,
        frames,
        banks,
        bank_history,
        star_lists,
        catalogues,
        jobs,
        status,
        viewer,
        database,
        replay,
        alarms,
        downloads=Downloads(link, transfers),
        tables=tables,
        images=images,
        authority=authority,
        history=CommandHistory(database),
        schedule=schedule,
        stacks=stacks,
        stack_runs=stack_runs,
        campaigns=campaigns,
        reprocessing=reprocessing,
        executor=executor,
        contacts=contacts,
        dispatcher=dispatcher,
        writer=writer,
        capture_replay=capture_replay,
        design=DesignService(jobs, stars),
        calibrations=calibrations,
        analyses=analyses,
        accounts=accounts,
        audit=AuditService(database, utc_now),
        upkeep=upkeep,
        streams=streams,
        parsing=parsing,
        place=place,
        scopes=Scopes(database, utc_now),
        recordings=recordings,
        live_recordings=LiveRecordings(recordings, database, bus, utc_now),
    )

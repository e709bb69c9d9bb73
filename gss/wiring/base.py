"""Services that all rooms use: settings, clocks, stores, events, jobs, stars and instruments."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.stars import StarTable
from gss.instruments.dictionary.definitions import Dictionary
from gss.instruments.package import Instrument
from gss.instruments.registry import Registry
from gss.operations.clock import Clock, utc_now
from gss.operations.events import EventBus
from gss.operations.folder_lock import own_folder
from gss.operations.jobs import JobService
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.operations.upkeep.clock_trust import ClockTrust
from gss.operations.upkeep.disk import DiskGuard
from gss.settings import Settings
from gss.store.blobs import BlobStore
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate


@dataclass(frozen=True)
class BaseServices:
    """Services that all rooms use. ``clock``: mission time. ``unit``: instrument of the unit on the line."""

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
        """Framing of the line from the settings; if not set, from the instrument package."""
        return self.settings.framing or self.unit.link.framing

    def version_of(self, name: str) -> str | None:
        """Return the version of an instrument, None if it is unknown. For the unit's instrument this is the version loaded at the
        start, for other instruments the installed version."""
        return self.unit.version if name == self.unit.name else self.instruments.version_of(name)

    @property
    def captures(self) -> Path:
        """Folder of the raw captures."""
        return self.settings.data / "captures"

    @property
    def upkeep_lock(self) -> Path:
        """Lock file of backups and removals of data. It prevents them from running at the same time."""
        return self.settings.data / "upkeep.lock"


def open_base(settings: Settings, clock: Clock, *, ready: bool) -> BaseServices:
    """Open the stores and create the services that all rooms use. ``ready``: the database schema is already upgraded."""
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
    instruments = Registry(settings.instruments_folder)
    unit = instruments.get(settings.unit_instrument)
    return BaseServices(
        settings,
        clock,
        database,
        blobs,
        bus,
        trust,
        disk,
        jobs,
        ParseProcesses(),
        load_stars(),
        instruments,
        unit,
    )

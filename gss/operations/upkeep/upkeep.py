"""The maintenance services, bundled for the wiring."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.metrics import Metrics
from gss.operations.upkeep.audit_watch import AuditWatch
from gss.operations.upkeep.backup import BackupService
from gss.operations.upkeep.check_store import CheckStoreService
from gss.operations.upkeep.clock_trust import ClockTrust
from gss.operations.upkeep.clocks import ClockWatch
from gss.operations.upkeep.disk import DiskGuard
from gss.operations.upkeep.forecast import Forecast, forecast
from gss.operations.upkeep.health import HealthService
from gss.operations.upkeep.page_check import PageCheck
from gss.operations.upkeep.retention import RetentionService
from gss.store import frames
from gss.store import upkeep as store
from gss.store.engine import Database
from gss.store.models import Frame


@dataclass(frozen=True)
class Upkeep:
    """All maintenance services."""

    database: Database
    disk: DiskGuard
    retention: RetentionService
    backups: BackupService
    check: CheckStoreService
    health: HealthService
    metrics: Metrics
    clocks: ClockWatch
    trust: ClockTrust
    pages: PageCheck
    audit: AuditWatch

    def favourite(self, frame_id: int, favourite: bool) -> Frame:
        """Mark a frame as favourite; retention never removes the pixels of favourites. Raises NotFound."""
        with self.database.unit_of_work() as session:
            frames.get(session, frame_id)
            store.set_favourite(session, frame_id, favourite)
        with self.database.unit_of_work() as session:
            return frames.get(session, frame_id)

    def forecast(self) -> Forecast:
        """Return the forecast of disk usage."""
        return forecast(self.database, self.retention, self.disk, self.backups.folder)

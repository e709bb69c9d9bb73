"""Stored comparisons of heads, read by time span or as the latest comparison of each head."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.operations.clock import Now
from gss.operations.heads.head_watch import KEPT, estimate_of
from gss.operations.heads.mountings import SpacecraftSetup
from gss.operations.heads.tracker import drift_sigma
from gss.pipeline.heads.misalignment import Misalignment
from gss.store import heads as store
from gss.store.engine import Database
from gss.store.models import FusedRow, HeadPairRow

MAX_POINTS = 600


@dataclass(frozen=True)
class StoredPair:
    """One stored comparison of a head with the reference head. ``sigma_rad`` (3,): standard deviation of the misalignment,
    including clock errors and steady errors. ``drift_sigma_rad_s`` (3,): standard deviation of the drift."""

    row: HeadPairRow
    misalignment: Misalignment
    sigma_rad: Array
    drift_sigma_rad_s: Array


class HeadHistory:
    """Reads comparisons from the store."""

    def __init__(self, database: Database, now: Now) -> None:
        self._database, self._now = database, now

    def pairs(self, spacecraft_id: int, hours: float) -> list[StoredPair]:
        """Return the comparisons of the last ``hours``, oldest first, thinned to about ``MAX_POINTS``. Raises BadInput
        for an invalid time span, NotFound for an unknown spacecraft."""
        max_hours = KEPT / timedelta(hours=1)
        if not 0 < hours <= max_hours:
            raise BadInput(
                "the span is out of range", expected=f"above 0, at most {max_hours:g} hours", got=f"{hours:g}"
            )
        end = self._now()
        with self._database.unit_of_work() as session:
            store.get(session, spacecraft_id)
            start = end - timedelta(hours=hours)
            rows = store.pairs_between(session, spacecraft_id, start, end + timedelta(minutes=1), MAX_POINTS)
        return [_stored(row) for row in rows]

    def newest(self, setup: SpacecraftSetup) -> tuple[FusedRow | None, list[StoredPair]]:
        """Return the latest stored fused attitude, and the latest comparison of each head since the last change of the
        spacecraft."""
        with self._database.unit_of_work() as session:
            fused = store.newest_fused(session, setup.id)
            rows = [store.newest_pair(session, setup.id, head.unit, setup.changed) for head in setup.heads[1:]]
        return fused, [_stored(row) for row in rows if row is not None]


def _stored(row: HeadPairRow) -> StoredPair:
    estimate = estimate_of(row)
    lasting = np.array(row.lasting)
    sigma = np.sqrt(estimate.sigma_rad**2 + lasting)
    return StoredPair(row, estimate, sigma, drift_sigma(estimate, lasting))

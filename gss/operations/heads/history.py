"""Stored comparisons of heads, read by time span or as the latest comparison of each head."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.operations.clock import Now
from gss.operations.heads.head_watch import KEPT, estimate_of
from gss.operations.heads.mountings import SpacecraftSetup
from gss.operations.heads.tracker import drift_sigma
from gss.orbit.attitude import AttitudeHistory
from gss.orbit.write_attitude import MessageFormat, attitude_message
from gss.pipeline.heads.misalignment import Misalignment
from gss.store import heads as store
from gss.store.engine import Database
from gss.store.models import FusedRow, HeadPairRow

MAX_POINTS = 600
MAX_ATTITUDES = 100_000
BODY_FRAME = "SC_BODY_1"
DIAGONAL = (0, 3, 5)
"""Positions of the variances in the upper triangle of a (3, 3) covariance."""


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

    def message(self, kind: MessageFormat, spacecraft_id: int, start: datetime, end: datetime) -> Iterator[str]:
        """Yield the lines of an AEM or ACM with the fused attitudes of the body in a time span. Raises BadInput, NotFound
        before the first line."""
        if end < start:
            raise BadInput("The time span is empty", expected="a start before the end", got=f"{start} … {end}")
        with self._database.unit_of_work() as session:
            name = store.get(session, spacecraft_id).name
            rows = store.fused_between(session, spacecraft_id, start, end, MAX_ATTITUDES + 1)
        if len(rows) > MAX_ATTITUDES:
            raise BadInput("There are too many attitudes in this time", expected=f"at most {MAX_ATTITUDES}")
        row_at = {row.at: row for row in rows}
        history = AttitudeHistory(
            name,
            BODY_FRAME,
            np.array([at.timestamp() for at in row_at]),
            np.array([row.quaternion for row in row_at.values()], float).reshape(-1, 4),
            np.sqrt([[row.covariance[k] for k in DIAGONAL] for row in row_at.values()]).reshape(-1, 3),
        )
        return attitude_message(kind, history, "DETERMINED_GND", self._now())

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

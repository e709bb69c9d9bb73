"""Time for accounts. It follows the system clock but never goes back, so an expired key does not become valid again if the
system clock is set back."""

from __future__ import annotations

import threading
from datetime import UTC, datetime, timedelta

from gss.operations.clock import Monotonic, Now
from gss.store import audit, choices
from gss.store.engine import Database


class ForwardClock:
    """Clock that returns the later of two times: the system time, and the latest returned time plus the monotonic time since
    then. ``floor``: initial value of the latest returned time."""

    def __init__(self, now: Now, monotonic_s: Monotonic, floor: datetime | None) -> None:
        self._now, self._monotonic_s = now, monotonic_s
        self._lock = threading.Lock()
        self._latest, self._latest_s = floor or now(), monotonic_s()

    def __call__(self) -> datetime:
        """Return the time in UTC."""
        with self._lock:
            now_s = self._monotonic_s()
            elapsed = timedelta(seconds=now_s - self._latest_s)
            self._latest, self._latest_s = max(self._now(), self._latest + elapsed), now_s
            return self._latest


def time_floor(database: Database) -> datetime | None:
    """Return the later of the latest audit row's time and the last trusted time, None in an empty database. The trusted time
    does not follow an implausible system clock."""
    with database.unit_of_work() as session:
        newest, trusted = audit.last(session), choices.trusted_time(session)
    moments = [moment.astimezone(UTC) for moment in (newest.at if newest else None, trusted) if moment is not None]
    return max(moments, default=None)

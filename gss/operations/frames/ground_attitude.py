"""Attitude of the sensor's latest frame that was solved on the ground, with the time of that frame."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from datetime import UTC

from gss.domain.angles import ARCSEC_RAD
from gss.domain.callbacks import no_progress
from gss.operations.events import EventBus
from gss.operations.line.clock_correlation import Correlation
from gss.operations.telemetry.last_attitude import RECEPTION_SIGMA_S, AttitudeSample
from gss.store import frames as store
from gss.store.engine import Database
from gss.store.models import Frame, Solution


class GroundAttitude:
    """Provides the latest attitude. The store is read only after a solution was published. ``clock``: correlation of the sensor's
    clock with UTC, which determines the uncertainty of the frame's time. Thread-safe."""

    def __init__(self, database: Database, bus: EventBus, clock: Callable[[], Correlation | None]) -> None:
        self._database, self._clock = database, clock
        self._subscription = bus.subscribe(no_progress)
        self._sample: AttitudeSample | None = None
        self._is_outdated = False
        self._lock = threading.Lock()

    def sample(self) -> AttitudeSample | None:
        """Return the latest attitude since the server started, None before the first."""
        with self._lock:
            messages, dropped = self._subscription.take()
            if dropped or any(message.topic == "solution" for message in messages):
                self._is_outdated = True
            if self._is_outdated:
                self._read()
                self._is_outdated = False  # only now, so that a failed read is repeated
            return self._sample

    def _read(self) -> None:
        with self._database.unit_of_work() as session:
            newest = store.newest_ground_attitude(session)
        if newest is not None:
            self._sample = _sample(*newest, self._clock())


def _sample(frame: Frame, solution: Solution, clock: Correlation | None) -> AttitudeSample | None:
    if solution.quaternion is None:
        return None
    x, y, z, w = (float(q) for q in solution.quaternion)
    cross, roll = (None if s is None else float(s) / ARCSEC_RAD for s in solution.sigma_rad or (None, None))
    at = frame.taken.astimezone(UTC)
    sigma_s = RECEPTION_SIGMA_S if clock is None else clock.uncertainty_at(at.timestamp())
    sigmas = [s if s is not None and math.isfinite(s) else None for s in (cross, roll)]
    return AttitudeSample("ground", (x, y, z, w), sigmas[0], sigmas[1], at, sigma_s)

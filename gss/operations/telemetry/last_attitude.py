"""The last attitude that a sensor reported as solved, in standard quantities."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

import numpy as np

from gss.device.protocol.packet import Arrival
from gss.device.session_events import Telemetry
from gss.domain.angles import ra_dec_from_unit
from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.telemetry_roles import AttitudeRole
from gss.operations.clock import Monotonic
from gss.operations.line.line_events import LineBatch, ServiceEvent

SOLVED = "solved"


@dataclass(frozen=True)
class ReportedAttitude:
    """Boresight of the last solved attitude. ``age_s``: since the ground received it; ``sigma_cross_arcsec``: None if the
    sensor does not report it; ``newest_outcome``: of the newest report, which may be a later one without a solution."""

    ra_deg: float
    dec_deg: float
    sigma_cross_arcsec: float | None
    age_s: float
    newest_outcome: str


class LastAttitude:
    """Keeps the last solved attitude. ``role``: where the instrument's telemetry has it. Thread-safe."""

    def __init__(self, role: AttitudeRole, monotonic_s: Monotonic) -> None:
        self._role, self._monotonic_s = role, monotonic_s
        self._solved: tuple[float, float, float, float | None] | None = None
        self._outcome = ""
        self._lock = threading.Lock()

    def handle(self, batch: LineBatch) -> list[ServiceEvent]:
        """Take the attitudes of a batch."""
        for event in batch.events:
            if isinstance(event, Telemetry) and event.packet == self._role.packet and event.arrival is Arrival.CURRENT:
                self._take(event, batch.at_s)
        return []

    def report(self) -> ReportedAttitude | None:
        """Return the last solved attitude; None before the first."""
        with self._lock:
            if self._solved is None:
                return None
            at_s, ra_deg, dec_deg, sigma = self._solved
            return ReportedAttitude(ra_deg, dec_deg, sigma, max(0.0, self._monotonic_s() - at_s), self._outcome)

    def _take(self, packet: Telemetry, at_s: float) -> None:
        values = self._role.read(packet.values)
        outcome = str(values.get("outcome", SOLVED))
        quaternion = np.array([float(values.get(f"quaternion_{axis}", math.nan)) for axis in "xyzw"])
        norm = float(np.linalg.norm(quaternion))
        solved = outcome == SOLVED and math.isfinite(norm) and norm > 0
        with self._lock:
            self._outcome = outcome
            if solved:
                boresight = matrix_from_quaternion(quaternion / norm).T @ np.array([0.0, 0.0, 1.0])
                ra_rad, dec_rad = ra_dec_from_unit(boresight)
                sigma = values.get("sigma_cross_arcsec")
                sigma_value = float(sigma) if isinstance(sigma, int | float) and math.isfinite(sigma) else None
                self._solved = (at_s, math.degrees(float(ra_rad)), math.degrees(float(dec_rad)), sigma_value)

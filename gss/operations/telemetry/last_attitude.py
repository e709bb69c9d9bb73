"""The last attitude that a sensor reported as solved, in standard quantities."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from gss.device.protocol.packet import Arrival
from gss.device.session_events import Telemetry
from gss.domain.angles import ra_dec_from_unit
from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.dictionary.definitions import Value
from gss.instruments.telemetry_roles import AttitudeRole
from gss.operations.clock import Monotonic
from gss.operations.line.clock_correlation import Correlation
from gss.operations.line.line_events import LineBatch, ServiceEvent

SOLVED = "solved"
RECEPTION_SIGMA_S = 1.0
"""Uncertainty in seconds of an attitude's time if only the time of reception is known. The line and the processing on
board delay a report by up to about this time."""
Clock = Callable[[], Correlation | None]


@dataclass(frozen=True)
class ReportedAttitude:
    """Boresight of the last solved attitude. ``age_s``: time since its reception on the ground; ``sigma_cross_arcsec``:
    None if the sensor does not report it; ``newest_outcome``: outcome of the latest report, which can be later than
    this attitude and have no solution."""

    ra_deg: float
    dec_deg: float
    sigma_cross_arcsec: float | None
    age_s: float
    newest_outcome: str


@dataclass(frozen=True)
class AttitudeSample:
    """One attitude with its time. ``quaternion``: cam_from_icrs; standard deviations are None if unknown;
    ``utc_sigma_s``: uncertainty of ``utc``."""

    source: Literal["on board", "ground"]
    quaternion: tuple[float, float, float, float]
    sigma_cross_arcsec: float | None
    sigma_roll_arcsec: float | None
    utc: datetime
    utc_sigma_s: float


class LastAttitude:
    """Stores the last solved attitude. ``role``: fields of the instrument's telemetry that contain it; ``clock``:
    returns the relation of the sensor's clock to UTC. Thread-safe."""

    def __init__(self, role: AttitudeRole, monotonic_s: Monotonic, clock: Clock) -> None:
        self._role, self._monotonic_s, self._clock = role, monotonic_s, clock
        self._solved: tuple[float, float, float, AttitudeSample] | None = None
        self._outcome, self._mode = "", ""
        self._lock = threading.Lock()

    def handle(self, batch: LineBatch) -> list[ServiceEvent]:
        """Store the latest attitude of a batch."""
        for event in batch.events:
            if isinstance(event, Telemetry) and event.packet == self._role.packet and event.arrival is Arrival.CURRENT:
                self._take(event, batch)
        return []

    def report(self) -> ReportedAttitude | None:
        """Return the boresight of the last solved attitude; None before the first solution."""
        with self._lock:
            if self._solved is None:
                return None
            at_s, ra_deg, dec_deg, sample = self._solved
            age_s = max(0.0, self._monotonic_s() - at_s)
            return ReportedAttitude(ra_deg, dec_deg, sample.sigma_cross_arcsec, age_s, self._outcome)

    def mode(self) -> str | None:
        """Return the mode in the latest report; None if the packet contains no mode."""
        with self._lock:
            return self._mode or None

    def sample(self) -> AttitudeSample | None:
        """Return the last solved attitude with its time; None before the first solution."""
        with self._lock:
            return None if self._solved is None else self._solved[3]

    def _take(self, packet: Telemetry, batch: LineBatch) -> None:
        values = self._role.read(packet.values)
        outcome = str(values.get("outcome", SOLVED))
        quaternion = np.array([float(values.get(f"quaternion_{axis}", math.nan)) for axis in "xyzw"])
        norm = float(np.linalg.norm(quaternion))
        solved = outcome == SOLVED and math.isfinite(norm) and norm > 0
        with self._lock:
            self._outcome, self._mode = outcome, str(values.get("mode", ""))
            if solved:
                x, y, z, w = (float(q) for q in quaternion / norm)
                boresight = matrix_from_quaternion(quaternion).T @ np.array([0.0, 0.0, 1.0])
                ra_rad, dec_rad = ra_dec_from_unit(boresight)
                cross, roll = (_number(values.get(f"sigma_{axis}_arcsec")) for axis in ("cross", "roll"))
                at, sigma_s = self._time(values.get("frame_time_s"), batch.at)
                sample = AttitudeSample("on board", (x, y, z, w), cross, roll, at, sigma_s)
                self._solved = (batch.at_s, math.degrees(float(ra_rad)), math.degrees(float(dec_rad)), sample)

    def _time(self, frame_time_s: Value | None, received: datetime) -> tuple[datetime, float]:
        """Return UTC of the exposure and its uncertainty, or UTC of the reception if the sensor's clock is not
        correlated."""
        correlation = self._clock()
        if correlation is None or not isinstance(frame_time_s, int | float) or not math.isfinite(frame_time_s):
            return received, RECEPTION_SIGMA_S
        utc_s = correlation.utc_of(float(frame_time_s))
        try:
            return datetime.fromtimestamp(utc_s, UTC), correlation.uncertainty_at(utc_s)
        except (ValueError, OverflowError):  # a faulty sensor can report a time outside the range of dates
            return received, RECEPTION_SIGMA_S


def _number(value: Value | None) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None

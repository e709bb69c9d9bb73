"""Export of the attitudes of stored frames as an attitude message, and comparison with the attitudes of another system."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import quaternion_inverse, quaternion_product, turn_between
from gss.operations.clock import Now
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.orbit.attitude import AttitudeHistory
from gss.orbit.read_attitude import read_attitude_file
from gss.orbit.write_attitude import MessageFormat, attitude_message
from gss.store.engine import Database
from gss.store.frame_attitudes import FrameAttitude, attitudes_between

AttitudeOrigin = Literal["ground", "on board"]
CAMERA_FRAME = "STARTRACKER_1"
MAX_FRAMES = 100_000
MEAN_STEPS = 20


@dataclass(frozen=True)
class ComparedAttitude:
    """Comparison of one frame's attitude with the attitude of another system. ``residual_rad`` (3,): rotation about the
    camera's axes that remains after the mean rotation between both systems was removed."""

    frame_id: int
    at: datetime
    residual_rad: Array


@dataclass(frozen=True)
class AttitudeComparison:
    """Comparison of the attitudes of frames with the attitudes of a message. ``cam_from_frame`` (4,): mean rotation from the
    message's frame to the camera, scalar-last. ``rms_rad`` (3,): rms of the residuals about the camera's axes. ``outside``: number
    of frames for which the message has no attitude."""

    object_name: str
    frame: str
    cam_from_frame: Array
    rms_rad: Array
    compared: Sequence[ComparedAttitude]
    outside: int


class AttitudeExchange:
    """Exports and compares the attitudes of the unit's frames. ``instrument``: its instrument; ``name``: function that returns the
    object name for messages."""

    def __init__(
        self, database: Database, parsing: ParseProcesses, instrument: str, name: Callable[[], str], now: Now
    ) -> None:
        self._database, self._parsing, self._now = database, parsing, now
        self._instrument, self._name = instrument, name

    def history(self, origin: AttitudeOrigin, start: datetime, end: datetime) -> AttitudeHistory:
        """Return the attitudes of the frames exposed in a time span. ``origin`` "ground": the operational ground results. "on
        board": the latest results of the sensor. If frames have the same time, the first one is used. Raises BadInput."""
        rows = {row.at: row for row in reversed(self._rows(origin, start, end))}
        ordered = [rows[at] for at in sorted(rows)]
        sigmas = [_sigma(row) for row in ordered]
        return AttitudeHistory(
            self._name(),
            CAMERA_FRAME,
            np.array([row.at.timestamp() for row in ordered]),
            np.array([row.quaternion for row in ordered], float).reshape(-1, 4),
            np.array(sigmas, float).reshape(-1, 3),
        )

    def message(self, kind: MessageFormat, origin: AttitudeOrigin, start: datetime, end: datetime) -> Iterator[str]:
        """Yield the lines of an AEM or ACM of a time span. Raises BadInput before the first line."""
        history = self.history(origin, start, end)
        return attitude_message(
            kind, history, "DETERMINED_GND" if origin == "ground" else "DETERMINED_OBC", self._now()
        )

    def compare(self, data: bytes, origin: AttitudeOrigin) -> AttitudeComparison:
        """Compare all frames in the time span of an AEM or ACM. Raises BadInput if the file is not valid or there is no frame."""
        other = self._parsing.parse(read_attitude_file, data, classes=(AttitudeHistory,), subject="the message")
        first, last = (datetime.fromtimestamp(float(t), UTC) for t in (other.times_s[0], other.times_s[-1]))
        rows = self._rows(origin, first, last)
        message_quaternions = other.at(np.array([row.at.timestamp() for row in rows], float))
        within = np.asarray(np.isfinite(message_quaternions).all(axis=1))
        if not within.any():
            raise BadInput(
                "No stored attitude lies within the message",
                expected="frames with a result in the time of the message",
                got=f"{first:%Y-%m-%d %H:%M:%S} to {last:%Y-%m-%d %H:%M:%S}",
            )
        compared_rows = [row for row, inside in zip(rows, within, strict=True) if inside]
        frame_quaternions = np.array([row.quaternion for row in compared_rows], float)
        mean, residuals = _mean_rotation(
            quaternion_product(frame_quaternions, quaternion_inverse(message_quaternions[within]))
        )
        return AttitudeComparison(
            other.object_name,
            other.frame,
            mean,
            np.sqrt((residuals**2).mean(axis=0)),
            [
                ComparedAttitude(row.id, row.at, residual)
                for row, residual in zip(compared_rows, residuals, strict=True)
            ],
            len(rows) - len(compared_rows),
        )

    def _rows(self, origin: AttitudeOrigin, start: datetime, end: datetime) -> list[FrameAttitude]:
        if end < start:
            raise BadInput("The time span is empty", expected="a start before the end", got=f"{start} … {end}")
        with self._database.unit_of_work() as session:
            rows = attitudes_between(session, self._instrument, origin, start, end, MAX_FRAMES + 1)
        if len(rows) > MAX_FRAMES:
            raise BadInput("There are too many frames in this time", expected=f"at most {MAX_FRAMES}")
        return rows


def _sigma(row: FrameAttitude) -> tuple[float, float, float]:
    """Return the standard deviations about x, y and z of the camera, NaN if the chain does not compute them."""
    cross, roll = row.sigma_rad or (np.nan, np.nan)
    return cross, cross, roll


def _mean_rotation(quaternions: Array) -> tuple[Array, Array]:
    """Return the (4,) mean of (n, 4) rotations, and the (n, 3) rotation vectors from the mean to each rotation."""
    mean = quaternions[0]
    for _ in range(MEAN_STEPS):
        turns = turn_between(np.broadcast_to(mean, quaternions.shape), quaternions)
        step = turns.mean(axis=0)
        half = step / 2
        mean = quaternion_product(np.append(half, 1.0) / np.sqrt(1 + half @ half), mean)
    turns = turn_between(np.broadcast_to(mean, quaternions.shape), quaternions)
    return (-mean if mean[3] < 0 else mean), turns

"""Data of the server as frozen dataclasses. Unknown fields of a newer server are ignored."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Json = Any
"""Decoded JSON value. Only this module checks the fields of the server's schema."""


class ClientRecord:
    """Base class of records, created from JSON objects with the same field names. Times are aware datetimes in UTC."""

    @classmethod
    def of(cls, values: Mapping[str, Json]) -> Self:
        """Create the record from a JSON object. Raises KeyError if a field is missing."""
        fields = dataclasses.fields(cls)  # type: ignore[arg-type]  # every subclass is a dataclass
        return cls(**{f.name: _converted(values[f.name], str(f.type)) for f in fields})


def _converted(value: Json, annotation: str) -> Json:
    if value is not None and annotation.startswith("datetime"):
        return datetime.fromisoformat(value)
    return value


@dataclass(frozen=True)
class Command(ClientRecord):
    """One command. ``result``: queued … completed, rejected, failed, unknown, resolved or withdrawn. ``values``: values
    that the sensor reported with completion."""

    id: int
    name: str
    text: str
    result: str
    detail: str
    created: datetime
    finished: datetime | None
    values: Mapping[str, Json]

    @property
    def ended(self) -> bool:
        """True if the server waits for no more reports. A late report or a user can still change the result ``unknown``."""
        return self.result in ("completed", "rejected", "failed", "unknown", "resolved", "withdrawn")


@dataclass(frozen=True)
class TelemetryValue(ClientRecord):
    """Latest value of one field. ``value``: value in ``unit``; None if never received. ``state``: ok, watch, warning,
    critical, stale or never. ``age_s``: seconds since it was received."""

    packet: str
    name: str
    value: Json
    formatted: str
    unit: str
    state: str
    age_s: float | None


@dataclass(frozen=True)
class Packet(ClientRecord):
    """One stored telemetry packet. ``values``: values by field name, in the units of the instrument's dictionary.
    ``device_time_s``: 0 if the sensor reports no time."""

    id: int
    packet: str
    received: datetime
    device_time_s: float
    contact_id: int | None
    values: Mapping[str, Json]


@dataclass(frozen=True)
class Event(ClientRecord):
    """One recorded event. ``seq`` increases by one with each event."""

    seq: int
    at: datetime
    kind: str
    severity: str
    text: str
    data: Mapping[str, Json]


@dataclass(frozen=True)
class Transfer(ClientRecord):
    """One upload or download. ``frame_id``: the stored frame of a completed image download."""

    id: int
    direction: str
    kind: str
    subject: str
    state: str
    reason: str
    size: int
    stored_bytes: int
    sha256: str
    frame_id: int | None

    @property
    def ended(self) -> bool:
        """True if no more bytes are expected."""
        return self.complete or self.state in ("failed", "aborted")

    @property
    def complete(self) -> bool:
        """True if all bytes were received and verified."""
        return self.state in ("done", "verified", "committed", "active")


@dataclass(frozen=True)
class Job(ClientRecord):
    """One background job of the server. ``done``, ``total``: completed steps and all steps."""

    id: int
    kind: str
    title: str
    state: str
    done: int
    total: int
    text: str
    result: Mapping[str, Json]

    @property
    def ended(self) -> bool:
        """True if the job has ended."""
        return self.state in ("done", "failed", "cancelled")


@dataclass(frozen=True)
class Frame(ClientRecord):
    """One stored image. ``outcome`` and ``matched``: values of the operational ground result; None if it does not
    exist."""

    id: int
    number: int | None
    name: str
    source: str
    taken: datetime
    columns: int
    rows: int
    bits: int
    exposure_s: float | None
    complete: bool
    outcome: str | None
    matched: int | None


@dataclass(frozen=True)
class Solution(ClientRecord):
    """Result of one chain for one frame. ``attitude``: JSON object with ``quaternion`` and other fields; None
    without a solution."""

    id: int
    frame_id: int
    chain: str
    outcome: str
    reason: str
    found: int
    matched: int
    rms_arcsec: float | None
    false_match_probability: float | None
    attitude: Mapping[str, Json] | None

    @property
    def quaternion(self) -> NDArray[np.float64] | None:
        """Attitude quaternion cam_from_icrs, scalar-last, shape (4,); None without a solution."""
        return None if self.attitude is None else np.array(self.attitude["quaternion"], dtype=float)


@dataclass(frozen=True)
class Star(ClientRecord):
    """A measured star of a solution. ``hip``: Hipparcos number, None without a match; ``dx_arcsec`` and ``dy_arcsec``: measured
    minus predicted position along columns and rows."""

    col_px: float
    row_px: float
    flux_dn: float
    hip: int | None
    name: str | None
    v_mag: float | None
    dx_arcsec: float | None
    dy_arcsec: float | None


@dataclass(frozen=True)
class Procedure(ClientRecord):
    """Stored procedure. ``mistakes``: number of mistakes; the procedure can start only if it is 0."""

    id: int
    name: str
    text: str
    steps: int
    mistakes: int


@dataclass(frozen=True)
class ProcedureRun(ClientRecord):
    """Run of a procedure. ``current``: next step or step in progress, "" at the end; ``entries``: records of the
    started steps; ``sha256``: hash of the frozen record of an ended run."""

    id: int
    name: str
    state: str
    current: str
    entries: list[Mapping[str, Json]]
    reason: str
    sha256: str
    steps: list[Mapping[str, Json]]

    @property
    def ended(self) -> bool:
        """True if the run is not in progress: it has ended, or a restart of the server interrupted it."""
        return self.state != "running"

    @property
    def under_way(self) -> bool:
        """True if a step has started and not ended."""
        return bool(self.entries) and not self.entries[-1]["ended"]

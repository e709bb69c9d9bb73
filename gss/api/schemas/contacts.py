"""Contacts, their record, their replay, their report."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from gss.api.schemas.alarms import AlarmRow
from gss.api.schemas.base import In, Out, Utc
from gss.api.schemas.telemetry import SeriesOut


class ContactOut(Out):
    """A contact: from opening the line to closing it."""

    id: int
    device: str
    url: str
    started: Utc
    ended: Utc | None
    rx_bytes: int
    tx_bytes: int
    frames: int
    commands: int
    note: str = ""


class SpanOut(Out):
    """A span without a good packet, and why."""

    start: Utc
    end: Utc
    seconds: float
    cause: str


class ContactFrameOut(Out):
    """A frame that came."""

    id: int
    name: str
    received: Utc


class ContactCommandOut(Out):
    """A command that went out."""

    id: int
    name: str
    result: str
    detail: str
    user: str
    created: Utc
    finished: Utc | None


class ContactTransferOut(Out):
    """A transfer that was begun."""

    id: int
    subject: str
    direction: str
    kind: str
    state: str
    reason: str
    size: int
    resent: int


class CaptureOut(Out):
    """A file of the raw capture; gone when not ``present``."""

    file: str
    bytes: int
    present: bool


class ContactDetailOut(ContactOut):
    """Everything of one contact. ``counters``: of what was received, and packets and bytes sent; ``gaps``: spans of more than
    three seconds without a good packet."""

    duration_s: float
    counters: dict[str, int]
    error_rate: float
    gaps: list[SpanOut]
    packets: dict[str, int]
    frame_list: list[ContactFrameOut]
    command_list: list[ContactCommandOut]
    transfers: list[ContactTransferOut]
    alarms: list[AlarmRow]
    events: int
    captures: list[CaptureOut]
    capture_bytes: int


class ContactNoteIn(In):
    """What an operator has to say about a contact; empty takes it away."""

    note: str = Field(max_length=4000)


class GapOut(Out):
    """A gap of the 1 Hz record. ``missing``: housekeeping packets."""

    start: Utc
    end: Utc
    missing: int
    cause: str
    explained: bool


class RecordOut(Out):
    """Is the housekeeping of a contact whole? ``late``: spans in which all came, but late."""

    contact_id: int
    expected: int
    held: int
    share: float
    unexplained: int
    gaps: list[GapOut]
    late: list[GapOut]


class VolumesOut(Out):
    """How much came and went."""

    rx_bytes: int
    tx_bytes: int
    telemetry_packets: int
    frame_bytes: int


class AttitudeSummaryOut(Out):
    """How the sensor found its attitude; pointings are (ra, dec, roll) in degrees."""

    iterations: int
    solved: int
    share: float | None
    sigma_cross_arcsec_median: float | None
    first: tuple[float, float, float] | None
    last: tuple[float, float, float] | None


class ReportOut(Out):
    """The pass report. ``quality``: (Unix seconds, share of damaged packets)."""

    contact: ContactDetailOut
    firmware: str
    profile: str
    volumes: VolumesOut
    attitude: AttitudeSummaryOut
    record: RecordOut
    series: list[SeriesOut]
    quality: list[tuple[float, float]]


Speed = Annotated[float, Field(ge=0.1, le=1000, strict=False)]


class ReplayIn(In):
    """How fast (null: as fast as possible), and from when on."""

    speed: Speed | None = 1.0
    start: Annotated[datetime, Field(strict=False)] | None = None


class ReplayChangeIn(In):
    """What is to be another; what is not given stays. ``speed`` null: as fast as possible. ``at``: go there."""

    speed: Speed | None = None
    paused: bool | None = None
    at: Annotated[datetime, Field(strict=False)] | None = None


class ReplayOut(Out):
    """Where the replay is. ``speed`` null: as fast as possible."""

    state: Literal["none", "running", "paused", "ended", "failed"]
    contact_id: int | None
    speed: float | None
    start: Utc | None
    end: Utc | None
    at: Utc | None
    share: float
    packets: int
    commands: int
    events: int
    damaged: int
    foreign: int
    reason: str


class ReplayCommandOut(Out):
    """A command of a replayed contact, or a report about it."""

    at: Utc
    request_id: int
    name: str
    stage: str
    arguments: dict[str, float | int | str | bool | None]
    detail: str


class ReplayEventOut(Out):
    """An event of the device in a replayed contact."""

    at: Utc
    name: str
    severity: str
    text: str

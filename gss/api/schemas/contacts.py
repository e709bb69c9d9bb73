"""Contacts, record checks, replays and pass reports."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from gss.api.schemas.alarms import AlarmRow
from gss.api.schemas.base import In, Out, Utc
from gss.api.schemas.handover import HandoverOut
from gss.api.schemas.procedures import ProcedureRunOut
from gss.api.schemas.telemetry import TelemetrySeriesOut


class ContactOut(Out):
    """Contact, from the opening to the closing of the line."""

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
    """Period without a valid packet, and its cause."""

    start: Utc
    end: Utc
    seconds: float
    cause: str


class ContactFrameOut(Out):
    """Frame received during a contact."""

    id: int
    name: str
    received: Utc


class ContactCommandOut(Out):
    """Command sent during a contact."""

    id: int
    name: str
    result: str
    detail: str
    user: str
    created: Utc
    finished: Utc | None


class ContactTransferOut(Out):
    """Transfer started during a contact."""

    id: int
    subject: str
    direction: str
    kind: str
    state: str
    reason: str
    size: int
    resent: int
    created: Utc
    finished: Utc | None


class CaptureOut(Out):
    """File of the raw capture; ``present`` is false if it was deleted."""

    file: str
    bytes: int
    present: bool


class ContactDetailOut(ContactOut):
    """All details of a contact. ``counters``: counters of received data, and numbers of sent packets and bytes;
    ``gaps``: periods of more than three seconds without a valid packet. ``instrument_version``: SHA-256 of the
    instrument package of the connected device; null: unknown. Each list contains at most the newest 500 entries, oldest
    first; ``frames``, ``commands`` and ``transfer_count`` are the totals."""

    instrument: str | None
    instrument_version: str | None
    duration_s: float
    counters: dict[str, int]
    error_rate: float
    gaps: list[SpanOut]
    packets: dict[str, int]
    frame_list: list[ContactFrameOut]
    command_list: list[ContactCommandOut]
    transfers: list[ContactTransferOut]
    transfer_count: int
    alarms: list[AlarmRow]
    events: int
    captures: list[CaptureOut]
    capture_bytes: int


class ContactNoteIn(In):
    """Operator's note about a contact; an empty text deletes it."""

    note: str = Field(max_length=4000)


class GapOut(Out):
    """Gap in the 1 Hz record. ``missing``: number of missing housekeeping packets."""

    start: Utc
    end: Utc
    missing: int
    cause: str
    explained: bool


class RecordOut(Out):
    """Completeness of a contact's housekeeping. ``late``: periods in which all packets arrived late."""

    contact_id: int
    expected: int
    held: int
    share: float
    unexplained: int
    gaps: list[GapOut]
    late: list[GapOut]


class VolumesOut(Out):
    """Data volumes received and sent."""

    rx_bytes: int
    tx_bytes: int
    telemetry_packets: int
    frame_bytes: int


class AttitudeSummaryOut(Out):
    """Summary of the sensor's attitude solutions; pointings are (ra, dec, roll) in degrees."""

    iterations: int
    solved: int
    share: float | None
    sigma_cross_arcsec_median: float | None
    first: tuple[float, float, float] | None
    last: tuple[float, float, float] | None


class ReportOut(Out):
    """Pass report. ``quality``: (Unix seconds, share of damaged packets). ``procedures``: procedure runs during the
    contact, with the hashes of their frozen records. ``handover``: checklist and hand-over notes."""

    contact: ContactDetailOut
    firmware: str
    profile: str
    volumes: VolumesOut
    attitude: AttitudeSummaryOut
    record: RecordOut
    series: list[TelemetrySeriesOut]
    quality: list[tuple[float, float]]
    procedures: list[ProcedureRunOut]
    handover: HandoverOut


Speed = Annotated[float, Field(ge=0.1, le=1000, strict=False)]


class ReplayIn(In):
    """Speed (null: as fast as possible) and start time of a replay."""

    speed: Speed | None = 1.0
    start: Annotated[datetime, Field(strict=False)] | None = None


class ReplayChangeIn(In):
    """Change of a running replay. Omitted values do not change. ``speed`` null: as fast as possible. ``at``: jump to
    this time."""

    speed: Speed | None = None
    paused: bool | None = None
    at: Annotated[datetime, Field(strict=False)] | None = None


class ReplayOut(Out):
    """State of the replay. ``speed`` null: as fast as possible."""

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
    """Command of a replayed contact, or a report about a command."""

    at: Utc
    request_id: int
    name: str
    stage: str
    arguments: dict[str, float | int | str | bool | None]
    detail: str


class ReplayEventOut(Out):
    """Event of the device in a replayed contact."""

    at: Utc
    name: str
    severity: str
    text: str

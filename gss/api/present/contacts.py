"""Contacts, record checks, replays and pass reports as responses."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from gss.api.present.alarms import alarm
from gss.api.present.procedures import run
from gss.api.present.telemetry import series
from gss.api.schemas.contacts import (
    AttitudeSummaryOut,
    CaptureOut,
    ContactCommandOut,
    ContactDetailOut,
    ContactFrameOut,
    ContactOut,
    ContactTransferOut,
    GapOut,
    RecordOut,
    ReplayCommandOut,
    ReplayEventOut,
    ReplayOut,
    ReportOut,
    SpanOut,
    VolumesOut,
)
from gss.api.schemas.handover import HandoverOut
from gss.device.session_events import DeviceEvent
from gss.operations.contacts.capture_decoder import CommandSaid, Replayed
from gss.operations.contacts.contact_report import ContactReport
from gss.operations.contacts.contacts import ContactDetail
from gss.operations.contacts.gaps import Gap, RecordCheck
from gss.operations.contacts.handover import Handover
from gss.operations.contacts.replay_capture import ReplayState
from gss.operations.telemetry.value_format import plain
from gss.store.models import Contact, Device, ProcedureRun

NO_RESPONSE = "no response"


def utc_from_unix_s(unix_s: float) -> datetime:
    """Return Unix seconds as a UTC datetime."""
    return datetime.fromtimestamp(unix_s, UTC)


def contact(row: Contact, device: Device | None, frames: int, commands: int) -> ContactOut:
    """Return a contact as a list entry."""
    return ContactOut(
        id=row.id,
        device=device.name if device else NO_RESPONSE,
        url=row.url,
        started=row.started,
        ended=row.ended,
        rx_bytes=row.rx_bytes,
        tx_bytes=row.tx_bytes,
        frames=frames,
        commands=commands,
        note=row.note,
    )


def detail(full: ContactDetail) -> ContactDetailOut:
    """Return all details of a contact."""
    head = contact(full.row, full.device, full.frames.total, full.commands.total)
    return ContactDetailOut(
        **head.model_dump(),
        instrument=full.row.instrument,
        instrument_version=full.row.instrument_version,
        duration_s=full.duration_s,
        counters=full.counters,
        error_rate=full.error_rate,
        gaps=[_span(gap) for gap in full.silences],
        packets=full.packets,
        frame_list=[ContactFrameOut.model_validate(row) for row in full.frames.rows],
        command_list=[ContactCommandOut.model_validate(row) for row in full.commands.rows],
        transfers=[ContactTransferOut.model_validate(row) for row in full.transfers.rows],
        transfer_count=full.transfers.total,
        alarms=[alarm(view) for view in full.alarms],
        events=full.events,
        captures=[CaptureOut.model_validate(file) for file in full.captures],
        capture_bytes=sum(file.bytes for file in full.captures),
    )


def _span(gap: Gap) -> SpanOut:
    return SpanOut(
        start=utc_from_unix_s(gap.from_s),
        end=utc_from_unix_s(gap.to_s),
        seconds=round(gap.to_s - gap.from_s, 3),
        cause=gap.cause,
    )


def _gap(gap: Gap) -> GapOut:
    return GapOut(
        start=utc_from_unix_s(gap.from_s),
        end=utc_from_unix_s(gap.to_s),
        missing=gap.missing,
        cause=gap.cause,
        explained=gap.explained,
    )


def record(contact_id: int, check: RecordCheck) -> RecordOut:
    """Return the check of a contact's record."""
    return RecordOut(
        contact_id=contact_id,
        expected=check.expected,
        held=check.held,
        share=check.share,
        unexplained=len(check.unexplained),
        gaps=[_gap(gap) for gap in check.gaps],
        late=[_gap(gap) for gap in check.late],
    )


def report(full: ContactReport, procedures: Sequence[ProcedureRun], handover: Handover) -> ReportOut:
    """Return the pass report with the procedure runs of that time, the checklist and the hand-over notes."""
    attitude, device = full.attitude, full.detail.device
    row = full.detail.row
    return ReportOut(
        contact=detail(full.detail),
        firmware=device.firmware if device else "",
        profile=device.profile if device else "",
        volumes=VolumesOut(
            rx_bytes=row.rx_bytes,
            tx_bytes=row.tx_bytes,
            telemetry_packets=full.telemetry_packets,
            frame_bytes=full.frame_bytes,
        ),
        attitude=AttitudeSummaryOut(
            iterations=attitude.iterations,
            solved=attitude.solved,
            share=attitude.share,
            sigma_cross_arcsec_median=attitude.sigma_cross_arcsec_median,
            first=attitude.first,
            last=attitude.last,
        ),
        record=record(row.id, full.record),
        series=[series(s) for s in full.series],
        quality=full.quality,
        procedures=[run(row) for row in procedures],
        handover=HandoverOut.model_validate(handover),
    )


def replay(state: ReplayState) -> ReplayOut:
    """Return the state of the replay."""
    start_s, end_s, at_s = state.start_s, state.end_s, state.at_s
    share = 0.0
    if start_s is not None and end_s is not None and at_s is not None:
        share = min(1.0, max(0.0, (at_s - start_s) / (end_s - start_s))) if end_s > start_s else 1.0
    return ReplayOut(
        state=state.state,  # type: ignore[arg-type]  # the operation uses the schema's values
        contact_id=state.contact_id,
        speed=state.speed,
        start=None if start_s is None else utc_from_unix_s(start_s),
        end=None if end_s is None else utc_from_unix_s(end_s),
        at=None if at_s is None else utc_from_unix_s(at_s),
        share=share,
        packets=state.packets,
        commands=state.commands,
        events=state.events,
        damaged=state.damaged,
        foreign=state.foreign,
        reason=state.reason,
    )


def replay_command(replayed: Replayed) -> ReplayCommandOut:
    """Return a command of a replayed contact."""
    report = replayed.item
    assert isinstance(report, CommandSaid)  # noqa: S101 - the topic has only this type
    return ReplayCommandOut(
        at=utc_from_unix_s(replayed.at_s),
        request_id=report.request_id,
        name=report.name,
        stage=report.stage,
        arguments={name: plain(value) for name, value in report.values.items()},
        detail=report.detail,
    )


def replay_event(replayed: Replayed) -> ReplayEventOut:
    """Return an event of a replayed contact."""
    event = replayed.item
    assert isinstance(event, DeviceEvent)  # noqa: S101 - the topic has only this type
    return ReplayEventOut(at=utc_from_unix_s(replayed.at_s), name=event.name, severity=event.severity, text=event.text)

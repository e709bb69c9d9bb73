"""Report of a contact for reading and printing."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from datetime import datetime

from gss.api.schemas.contacts import ReportOut
from gss.operations.contacts.handover import CheckedItem
from gss.operations.report.parts import Fact, Note, Number, Plot, Report, Section, Series, Table

GAP_SHARE, GAP_S = 0.02, 12.0
"""The line of a plot is interrupted between two samples if the time between them exceeds ``GAP_S`` seconds and also the
share ``GAP_SHARE`` of the plotted time."""


def contact_sheet(report: ReportOut) -> Report:
    """Return the report of a contact in parts, which can be rendered as HTML or PDF."""
    contact = report.contact
    firmware, profile = report.firmware or "unknown", report.profile or "unknown"
    until = _when(contact.ended) if contact.ended else "still open"
    return Report(
        f"Contact {contact.id}: {contact.device}",
        f"{contact.url}, {_when(contact.started)} to {until} ({_duration(contact.duration_s)}), "
        f"firmware {firmware}, profile {profile}",
        [
            *([Section("Note", contact.note)] if contact.note else []),
            *_handover(report),
            Section("Link and volume", facts=_link_facts(report)),
            _record(report),
            Section("Attitude", facts=_attitude_facts(report), drawings=[*_plots(report)]),
            *_lists(report),
        ],
        _notes(report),
    )


def _handover(report: ReportOut) -> list[Section]:
    """Return the checklist and the hand-over notes of the contact."""
    handover = report.handover
    done = sum(item.done for item in handover.items)
    rows = [[item.text, _state(item), item.user or "–", _when(item.at) if item.at else "–"] for item in handover.items]
    # A contact of an earlier version has no stored list; then only the checked items are known.
    is_stored = handover.checklist.version > 0
    words = f"{done} of {len(rows)} items done" if is_stored else f"{done} items checked; the list is not stored"
    checklist = Table(words, ["item", "state", "by", "time"], rows)
    sections = [Section("Checklist", tables=[checklist])] if rows else []
    for note in handover.notes:
        read = "not acknowledged"
        if note.acknowledged:
            read = f"acknowledged by {note.acknowledged_by}, {_when(note.acknowledged)}"
        sections.append(Section(f"Hand-over note of {note.user}, {_when(note.at)}, {read}", note.text))
    return sections


def _state(item: CheckedItem) -> str:
    if item.done:
        return "done"
    return f"check of {item.unchecked} removed" if item.unchecked else "not done"


def _notes(report: ReportOut) -> list[Note]:
    missing = report.record.unexplained
    if not missing:
        return []
    return [Note(f"{missing} gaps have no known cause.", "See the section Record.")]


def _lists(report: ReportOut) -> list[Section]:
    contact = report.contact
    return [
        _listed(
            "Commands",
            ("sent", "command", "by", "result", "detail"),
            [(_clock(x.created), x.name, x.user, x.result, x.detail) for x in contact.command_list],
            contact.commands,
        ),
        _listed(
            "Procedures",
            ("started", "procedure", "by", "state", "steps", "SHA-256 of the record"),
            [
                (
                    _clock(p.started),
                    f"{p.id}: {p.name}",
                    p.user,
                    p.state,
                    f"{len(p.entries)}",
                    p.sha256 or "not frozen",
                )
                for p in report.procedures
            ],
        ),
        _listed(
            "Transfers",
            ("content", "direction", "state", "bytes", "resent", "reason"),
            [(x.subject, x.direction, x.state, f"{x.size}", f"{x.resent}", x.reason) for x in contact.transfers],
            contact.transfer_count,
        ),
        _listed(
            "Alarms",
            ("raised", "alarm", "worst", "state", "closed", "by"),
            [
                (_clock(a.raised), a.text, a.worst, a.state, _clock(a.closed), a.acknowledged_by or "")
                for a in contact.alarms
            ],
        ),
        _listed(
            "Frames", ("received", "frame"), [(_clock(f.received), f.name) for f in contact.frame_list], contact.frames
        ),
        _listed(
            "Raw capture",
            ("file", "bytes", "stored"),
            [(f.file, f"{f.bytes}", "yes" if f.present else "deleted") for f in contact.captures],
        ),
    ]


def _listed(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], total: int = 0) -> Section:
    if total > len(rows):
        title = f"{title}, the latest {len(rows)} of {total}"
    return Section(title, tables=[Table("", list(columns), [list(row) for row in rows])])


def _link_facts(report: ReportOut) -> list[Fact]:
    contact, volumes = report.contact, report.volumes
    facts = [
        ("received", f"{volumes.rx_bytes} B"),
        ("sent", f"{volumes.tx_bytes} B"),
        ("telemetry packets", f"{volumes.telemetry_packets}"),
        ("good packets", f"{contact.counters.get('good', 0)}"),
        ("damaged packets", f"{100 * contact.error_rate:.2f} %"),
        ("packets missing by sequence count", f"{contact.counters.get('gaps', 0)}"),
        ("bad checksum", f"{contact.counters.get('bad_crc', 0)}"),
        ("too long or short", f"{contact.counters.get('too_long', 0) + contact.counters.get('too_short', 0)}"),
        ("frames", f"{contact.frames}, {volumes.frame_bytes} B"),
    ]
    return [Fact(*fact) for fact in facts]


def _attitude_facts(report: ReportOut) -> list[Fact]:
    attitude = report.attitude
    sigma = attitude.sigma_cross_arcsec_median
    facts = [
        ("results reported by the sensor", f"{attitude.iterations}"),
        ("solved", f"{attitude.solved}" + (f" ({100 * attitude.share:.1f} %)" if attitude.share is not None else "")),
        ("median cross-boresight σ", "–" if sigma is None else f"{sigma:.1f}″"),
    ]
    for name, pointing in (("first", attitude.first), ("last", attitude.last)):
        if pointing is not None:
            ra, dec, roll = pointing
            facts += [(f"{name} RA", f"{ra:.4f}°"), (f"{name} Dec", f"{dec:+.4f}°"), (f"{name} roll", f"{roll:.3f}°")]
    return [Fact(*fact) for fact in facts]


def _record(report: ReportOut) -> Section:
    record = report.record
    share = math.floor(1e4 * record.share) / 100
    text = f"{record.held} of {record.expected} housekeeping packets ({share:.2f} %); {record.unexplained} gaps without a cause"
    gaps = [[_clock(g.start), _clock(g.end), f"{g.missing}", g.cause] for g in record.gaps]
    silences = [[_clock(g.start), _clock(g.end), f"{g.seconds:.1f} s", g.cause] for g in report.contact.gaps]
    tables = [Table("Packets missing by sequence count", ["from", "to", "missing", "cause"], gaps)]
    if silences:
        tables.append(Table("No good packet for more than 3 s", ["from", "to", "duration", "cause"], silences))
    return Section("Record", text, tables=tables)


def _plots(report: ReportOut) -> list[Plot]:
    plots = [_plot(s.title, s.unit, s.t, s.y) for s in report.series if any(y is not None for y in s.y)]
    if report.quality:
        plots.append(
            _plot("Damaged packets", "%", [at for at, _ in report.quality], [100 * y for _, y in report.quality])
        )
    return plots


def _plot(title: str, unit: str, times_s: Sequence[float], y: Sequence[Number]) -> Plot:
    return Plot(title, "UTC", unit, [_broken(title, times_s, y)], time=True)


def _broken(label: str, times_s: Sequence[float], y: Sequence[Number]) -> Series:
    """Return a series with a gap (None) between samples that are too far apart to be connected."""
    longest_s = max(GAP_S, GAP_SHARE * (times_s[-1] - times_s[0]))
    at, value = [times_s[0]], [y[0]]
    for (before, _), (now, sample) in itertools.pairwise(zip(times_s, y, strict=True)):
        if now - before > longest_s:
            at.append((before + now) / 2)
            value.append(None)
        at.append(now)
        value.append(sample)
    return Series(label, at, value)


def _when(at: datetime) -> str:
    return f"{at:%Y-%m-%d %H:%M:%S} UTC"


def _clock(at: datetime | None) -> str:
    return f"{at:%H:%M:%S}" if at else "–"


def _duration(seconds: float) -> str:
    minutes, seconds_left = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min {seconds_left:02d} s" if hours else f"{minutes} min {seconds_left:02d} s"

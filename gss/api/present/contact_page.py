"""The pass report as one page to read and to print: no scripts, nothing from elsewhere, drawings inside."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime
from html import escape

from gss.api.present.svg_plot import plot
from gss.api.schemas.contacts import ReportOut

STYLE = """
@page { size: A4; margin: 15mm }
body { font: 10pt/1.4 system-ui, sans-serif; color: #111; background: #fff; max-width: 180mm; margin: 8mm auto }
h1 { font-size: 16pt; margin: 0 0 1mm } h2 { font-size: 11pt; margin: 6mm 0 1.5mm; border-bottom: 1px solid #999 }
p { margin: 1mm 0 } .soft { color: #555 } .bad { color: #a40000; font-weight: 600 } .good { color: #1a6b1a }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums }
th, td { text-align: left; padding: .6mm 3mm .6mm 0; vertical-align: top; border-bottom: 1px solid #ddd }
th { font-weight: 600 } td.n, th.n { text-align: right }
.facts { display: grid; grid-template-columns: repeat(3, 1fr); gap: 1mm 6mm } .facts dt { color: #555 }
.facts div { display: flex; justify-content: space-between } .facts dt, .facts dd { margin: 0 }
figure { margin: 2mm 0; break-inside: avoid } figcaption { color: #555 } tr { break-inside: avoid }
svg { width: 100%; height: auto }
pre { white-space: pre-wrap; font: inherit; margin: 0 }
@media print { body { margin: 0; max-width: none } }
"""


def contact_page(report: ReportOut) -> str:
    """The whole page."""
    c = report.contact
    title = f"Contact {c.id}: {c.device}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p class='soft'>{escape(c.url)}, {_when(c.started)} to {_when(c.ended) if c.ended else 'still open'}"
        f" ({_duration(c.duration_s)}), firmware {escape(report.firmware or 'not told')}, "
        f"profile {escape(report.profile or 'not told')}</p>",
        f"<h2>Note</h2><pre>{escape(c.note)}</pre>" if c.note else "",
        "<h2>Link and volume</h2>",
        _facts(_link_facts(report)),
        "<h2>Record</h2>",
        _record(report),
        "<h2>Attitude</h2>",
        _facts(_attitude_facts(report)),
        _plots(report),
        "<h2>Commands</h2>",
        _table(
            ("sent", "command", "by", "result", "detail"),
            [(_clock(x.created), x.name, x.user, x.result, x.detail) for x in c.command_list],
        ),
        "<h2>Transfers</h2>",
        _table(
            ("what", "way", "state", "bytes", "resent", "reason"),
            [(x.subject, x.direction, x.state, f"{x.size}", f"{x.resent}", x.reason) for x in c.transfers],
        ),
        "<h2>Alarms</h2>",
        _table(
            ("raised", "alarm", "worst", "state", "closed", "by"),
            [(_clock(a.raised), a.text, a.worst, a.state, _clock(a.closed), a.acknowledged_by or "") for a in c.alarms],
        ),
        "<h2>Frames</h2>",
        _table(("received", "frame"), [(_clock(f.received), f.name) for f in c.frame_list]),
        "<h2>Raw capture</h2>",
        _table(
            ("file", "bytes", "kept"), [(f.file, f"{f.bytes}", "yes" if f.present else "dropped") for f in c.captures]
        ),
    ]
    head = f"<meta charset='utf-8'><title>{escape(title)}</title><style>{STYLE}</style>"
    return f"<!doctype html><html lang='en'><head>{head}</head><body>{''.join(parts)}</body></html>"


def _link_facts(report: ReportOut) -> list[tuple[str, str]]:
    c, v = report.contact, report.volumes
    return [
        ("received", f"{v.rx_bytes} B"),
        ("sent", f"{v.tx_bytes} B"),
        ("telemetry packets", f"{v.telemetry_packets}"),
        ("good packets", f"{c.counters.get('good', 0)}"),
        ("damaged packets", f"{100 * c.error_rate:.2f} %"),
        ("missing by sequence", f"{c.counters.get('gaps', 0)}"),
        ("bad checksum", f"{c.counters.get('bad_crc', 0)}"),
        ("too long or short", f"{c.counters.get('too_long', 0) + c.counters.get('too_short', 0)}"),
        ("frames", f"{c.frames}, {v.frame_bytes} B"),
    ]


def _attitude_facts(report: ReportOut) -> list[tuple[str, str]]:
    a = report.attitude
    sigma = a.sigma_cross_arcsec_median
    facts = [
        ("iterations", f"{a.iterations}"),
        ("solved", f"{a.solved}" + (f" ({100 * a.share:.1f} %)" if a.share is not None else "")),
        ("median sigma across", "–" if sigma is None else f"{sigma:.1f}″"),
    ]
    for name, pointing in (("first", a.first), ("last", a.last)):
        if pointing is not None:
            ra, dec, roll = pointing
            facts += [(f"{name} RA", f"{ra:.4f}°"), (f"{name} Dec", f"{dec:+.4f}°"), (f"{name} roll", f"{roll:.3f}°")]
    return facts


def _record(report: ReportOut) -> str:
    r = report.record
    word = "good" if not r.unexplained else "bad"
    said = (
        f"{r.held} of {r.expected} housekeeping packets ({100 * r.share:.2f} %); {r.unexplained} gaps without a cause"
    )
    gaps = [(_clock(g.start), _clock(g.end), f"{g.missing}", g.cause) for g in r.gaps]
    silences = [(_clock(g.start), _clock(g.end), f"{g.seconds:.1f} s", g.cause) for g in report.contact.gaps]
    quiet = (
        f"<p>No good packet for more than 3 s:</p>{_table(('from', 'to', 'for', 'cause'), silences)}"
        if silences
        else ""
    )
    return f"<p class='{word}'>{said}</p>{_table(('from', 'to', 'missing', 'cause'), gaps)}{quiet}"


def _plots(report: ReportOut) -> str:
    drawn = [s for s in report.series if any(y is not None for y in s.y)]
    figures = [(f"{s.title}, {s.unit}" if s.unit else s.title, plot(s.t, s.y)) for s in drawn]
    if report.quality:
        t, y = [at for at, _ in report.quality], [100 * share for _, share in report.quality]
        figures.append(("Damaged packets, %", plot(t, y)))
    return "".join(f"<figure><figcaption>{escape(title)}</figcaption>{svg}</figure>" for title, svg in figures)


def _facts(facts: Iterable[tuple[str, str]]) -> str:
    rows = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in facts)
    return f"<dl class='facts'>{rows}</dl>"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return "<p class='soft'>None.</p>"
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _when(at: datetime) -> str:
    return f"{at:%Y-%m-%d %H:%M:%S} UTC"


def _clock(at: datetime | None) -> str:
    return f"{at:%H:%M:%S}" if at else "–"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min {rest:02d} s" if hours else f"{minutes} min {rest:02d} s"

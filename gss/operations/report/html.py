"""Renders a report as a single HTML file with inline drawings, without scripts and external resources."""

from __future__ import annotations

from gss.operations.report.draw import WIDTH, draw, height_of
from gss.operations.report.parts import Drawing, Drawn, Fact, Note, Picture, Report, Section, Table
from gss.operations.report.pens import SvgPen, escaped

STYLE = """
@page { size: A4; margin: 15mm }
body { font: 10pt/1.4 system-ui, sans-serif; color: #111; background: #fff; max-width: 180mm; margin: 8mm auto }
h1 { font-size: 16pt; margin: 0 0 1mm } h2 { font-size: 11pt; margin: 6mm 0 1.5mm; border-bottom: 1px solid #999 }
h3 { font-size: 10pt; margin: 3mm 0 1mm } p { margin: 1mm 0; white-space: pre-line } .soft { color: #555 }
.note { border-left: 3px solid #a04600; padding-left: 3mm; margin: 2mm 0 } .severe { border-color: #bf1e2e }
table { border-collapse: collapse; max-width: 100%; font-variant-numeric: tabular-nums }
th, td { text-align: left; padding: .6mm 4mm .6mm 0; vertical-align: top; border-bottom: 1px solid #ddd }
dl { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: .6mm 8mm; margin: 0 }
dl div { display: flex; justify-content: space-between; border-bottom: 1px solid #eee }
dt { color: #555 } dd { margin: 0 0 0 3mm; text-align: right; overflow-wrap: anywhere; font-variant-numeric: tabular-nums }
figure { margin: 3mm 0; break-inside: avoid } tr { break-inside: avoid } svg, img { width: 100%; height: auto }
@media print { body { margin: 0; max-width: none } }
"""


def as_html(report: Report) -> str:
    """Return the HTML file."""
    body = "".join(
        [
            f"<h1>{escaped(report.title)}</h1><p class='soft'>{escaped(report.subtitle)}</p>",
            *map(_note, report.notes),
            *map(_section, report.sections),
        ]
    )
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{escaped(report.title)}</title>"
        f"<style>{STYLE}</style></head><body>{body}</body></html>"
    )


def _note(note: Note) -> str:
    label = "Do not rely on this" if note.severe else "Note"
    css_class = "note severe" if note.severe else "note"
    return f"<p class='{css_class}'><b>{label}:</b> {escaped(note.text)} <span class='soft'>{escaped(note.hint)}</span></p>"


def _section(section: Section) -> str:
    text = f"<p>{escaped(section.text)}</p>" if section.text else ""
    facts = f"<dl>{''.join(map(_fact, section.facts))}</dl>" if section.facts else ""
    drawings = "".join(f"<figure>{_drawn(d)}</figure>" for d in section.drawings)
    return f"<h2>{escaped(section.title)}</h2>{text}{facts}{drawings}{''.join(map(_table, section.tables))}"


def _fact(fact: Fact) -> str:
    note = f" <span class='soft'>{escaped(fact.note)}</span>" if fact.note else ""
    unit = f" <span class='soft'>{escaped(fact.unit)}</span>" if fact.unit else ""
    return f"<div><dt>{escaped(fact.label)}{note}</dt><dd>{escaped(fact.value)}{unit}</dd></div>"


def _drawn(drawing: Drawing) -> str:
    if not isinstance(drawing, Picture):
        return as_svg(drawing)
    title, note = escaped(drawing.title), escaped(drawing.note)
    return (
        f"<figcaption>{title} <span class='soft'>{note}</span></figcaption>"
        f"<img alt='{title}' src='data:image/png;base64,{escaped(drawing.png)}'>"
    )


def as_svg(drawing: Drawn) -> str:
    """Return one drawing as SVG."""
    pen = SvgPen(WIDTH, height_of(drawing), drawing.title)
    draw(pen, drawing)
    return pen.svg()


def _table(table: Table) -> str:
    head = "".join(f"<th>{escaped(c)}</th>" for c in table.columns)
    rows = "".join("<tr>" + "".join(f"<td>{escaped(v)}</td>" for v in row) + "</tr>" for row in table.rows)
    title = f"<h3>{escaped(table.title)}</h3>" if table.title else ""
    if not table.rows:
        return f"{title}<p class='soft'>None.</p>"
    return f"{title}<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"

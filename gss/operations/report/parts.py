"""The parts of a report. Plain values only: a report is stored as JSON and drawn later by whoever shows it.

Angles, times and the like are already in the unit that is written beside them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

Number = float | None
"""None where there is nothing to draw."""


@dataclass(frozen=True)
class Fact:
    """One figure in words: label, value as text, unit, and what to know about it."""

    label: str
    value: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class Series:
    """Numbers of a plot. ``style``: line, dots, bars (x: left edges and one last right edge) or steps."""

    label: str
    x: list[float]
    y: list[Number]
    style: str = "line"


@dataclass(frozen=True)
class Level:
    """A horizontal line with its word; ``vertical``: an upright one."""

    value: float
    label: str
    vertical: bool = False


@dataclass(frozen=True)
class Plot:
    """Axes with series. ``log_y``: decades. ``time``: x are Unix seconds."""

    title: str
    x_label: str
    y_label: str
    series: list[Series]
    levels: list[Level] = field(default_factory=list)
    log_y: bool = False
    time: bool = False
    kind: str = "plot"


@dataclass(frozen=True)
class Arrows:
    """Little vectors over the detector: (col, row) and (d col, d row) in pixels, drawn ``scale`` times too long."""

    title: str
    columns: int
    rows: int
    col: list[float]
    row: list[float]
    d_col: list[Number]
    d_row: list[Number]
    scale: float
    note: str = ""
    kind: str = "arrows"


@dataclass(frozen=True)
class Cells:
    """A map over the detector: rows of values, None where nothing was seen; ``unit`` of the values."""

    title: str
    columns: int
    rows: int
    values: list[list[Number]]
    unit: str
    kind: str = "cells"


@dataclass(frozen=True)
class Picture:
    """A grey picture of the detector: a PNG file in base64. ``note``: what black and white stand for."""

    title: str
    png: str
    note: str = ""
    kind: str = "picture"


Drawing = Plot | Arrows | Cells | Picture


@dataclass(frozen=True)
class Table:
    """Columns and rows of text."""

    title: str
    columns: list[str]
    rows: list[list[str]]


@dataclass(frozen=True)
class Note:
    """What the reader should know and do. ``severe``: do not use the figures before."""

    text: str
    hint: str = ""
    severe: bool = False
    code: str = ""


@dataclass(frozen=True)
class Section:
    """A heading with what belongs to it."""

    title: str
    text: str = ""
    facts: list[Fact] = field(default_factory=list)
    drawings: list[Drawing] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)


@dataclass(frozen=True)
class Report:
    """The whole. ``subtitle``: of what, when."""

    title: str
    subtitle: str
    sections: list[Section]
    notes: list[Note] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def report_from(content: dict[str, Any]) -> Report:
    """The report of its plain values."""
    return Report(
        content["title"],
        content["subtitle"],
        [_section(s) for s in content["sections"]],
        [Note(**n) for n in content["notes"]],
    )


def _section(s: dict[str, Any]) -> Section:
    return Section(
        s["title"],
        s["text"],
        [Fact(**f) for f in s["facts"]],
        [_drawing(d) for d in s["drawings"]],
        [Table(**t) for t in s["tables"]],
    )


def _drawing(d: dict[str, Any]) -> Drawing:
    if d["kind"] == "plot":
        return Plot(
            **{**d, "series": [Series(**s) for s in d["series"]], "levels": [Level(**level) for level in d["levels"]]}
        )
    if d["kind"] == "picture":
        return Picture(**d)
    return Arrows(**d) if d["kind"] == "arrows" else Cells(**d)

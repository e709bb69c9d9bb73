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
    """Numbers of a plot. ``style``: line, dots, or bars (x: left edges and one last right edge)."""

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
    """Axes with series. ``log_x``, ``log_y``: decades. ``time``: x are Unix seconds."""

    title: str
    x_label: str
    y_label: str
    series: list[Series]
    levels: list[Level] = field(default_factory=list)
    log_y: bool = False
    time: bool = False
    log_x: bool = False
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


Place = tuple[float, float]
"""On the sky: right ascension and declination in degrees. On a drawing to scale: millimetres across and up."""


@dataclass(frozen=True)
class SkyMap:
    """The whole sky by Mollweide, ICRS, right ascension to the left. ``values``: HEALPix ring pixels of ``nside``, white where None
    or 0. ``stars``: right ascension, declination in degrees and V. ``solid``, ``dashed``: lines. ``mark``: a place and words."""

    title: str
    nside: int
    values: list[Number]
    note: str = ""
    stars: list[tuple[float, float, float]] = field(default_factory=list)
    solid: list[list[Place]] = field(default_factory=list)
    dashed: list[list[Place]] = field(default_factory=list)
    mark: tuple[float, float, str] | None = None
    kind: str = "sky"


@dataclass(frozen=True)
class Shares:
    """Parts beside each other in a whole, in ``unit``."""

    title: str
    parts: list[tuple[str, float]]
    whole: float
    unit: str
    kind: str = "shares"


@dataclass(frozen=True)
class Outline:
    """Lines to scale in millimetres, y upwards: a section through a thing. ``bold``: what light goes through."""

    title: str
    lines: list[list[Place]]
    bold: list[list[Place]] = field(default_factory=list)
    kind: str = "outline"


Drawn = Plot | Arrows | Cells | SkyMap | Shares | Outline
"""What a pen draws."""
Drawing = Drawn | Picture


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


KINDS: dict[str, type[Arrows | Cells | Picture | SkyMap | Shares | Outline]] = {
    "arrows": Arrows,
    "cells": Cells,
    "picture": Picture,
    "sky": SkyMap,
    "shares": Shares,
    "outline": Outline,
}


def _drawing(d: dict[str, Any]) -> Drawing:
    if d["kind"] == "plot":
        return Plot(
            **{**d, "series": [Series(**s) for s in d["series"]], "levels": [Level(**level) for level in d["levels"]]}
        )
    return KINDS[d["kind"]](**d)

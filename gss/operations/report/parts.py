"""The parts of a report. A part contains only plain values, because a report is stored as JSON, sent to pages and
rendered later. Each value is already in the unit that is stated beside it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, Field, TypeAdapter

from gss.domain.json_object import JsonObject

Number = float | None
"""A value to draw; None if there is no value."""


class ReportPart:
    """Base class of the parts. The API document states that all fields are always present."""

    __pydantic_config__: ClassVar = ConfigDict(json_schema_serialization_defaults_required=True)


@dataclass(frozen=True)
class Fact(ReportPart):
    """One value as text: label, value, unit, and a note."""

    label: str
    value: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class Series(ReportPart):
    """Data of a plot. ``style``: line, dots, or bars (``x``: the left edges, then the right edge of the last bar)."""

    label: str
    x: list[float]
    y: list[Number]
    style: Literal["line", "dots", "bars"] = "line"


@dataclass(frozen=True)
class Level(ReportPart):
    """A labelled line, horizontal or ``vertical``."""

    value: float
    label: str
    vertical: bool = False


@dataclass(frozen=True)
class Plot(ReportPart):
    """Axes with series. ``log_x``, ``log_y``: logarithmic axes. ``time``: x values are Unix
    seconds."""

    title: str
    x_label: str
    y_label: str
    series: list[Series]
    levels: list[Level] = field(default_factory=list)
    log_y: bool = False
    time: bool = False
    log_x: bool = False
    kind: Literal["plot"] = "plot"


@dataclass(frozen=True)
class Arrows(ReportPart):
    """Vectors over the detector: (col, row) and (d col, d row) in pixels. Each arrow is drawn ``scale`` times longer
    than its vector."""

    title: str
    columns: int
    rows: int
    col: list[float]
    row: list[float]
    d_col: list[Number]
    d_row: list[Number]
    scale: float
    note: str = ""
    kind: Literal["arrows"] = "arrows"


@dataclass(frozen=True)
class Cells(ReportPart):
    """A map over the detector. ``values``: rows of values, None for cells without data; ``unit``: unit of the
    values."""

    title: str
    columns: int
    rows: int
    values: list[list[Number]]
    unit: str
    kind: Literal["cells"] = "cells"


@dataclass(frozen=True)
class Picture(ReportPart):
    """A grey picture of the detector: a PNG file in base64. ``note``: meaning of black and white."""

    title: str
    png: str
    note: str = ""
    kind: Literal["picture"] = "picture"


Place = tuple[float, float]
"""A position. On the sky: right ascension and declination in degrees. On a scale drawing: millimetres across and up."""


@dataclass(frozen=True)
class SkyMap(ReportPart):
    """The whole sky in Mollweide projection, ICRS, right ascension increasing to the left. ``values``: HEALPix ring
    pixels of ``nside``; pixels with None or 0 are white. ``stars``: right ascension, declination in degrees and V.
    ``solid``, ``dashed``: lines. ``mark``: a position and its label."""

    title: str
    nside: int
    values: list[Number]
    note: str = ""
    stars: list[tuple[float, float, float]] = field(default_factory=list)
    solid: list[list[Place]] = field(default_factory=list)
    dashed: list[list[Place]] = field(default_factory=list)
    mark: tuple[float, float, str] | None = None
    kind: Literal["sky"] = "sky"


@dataclass(frozen=True)
class WorldMap(ReportPart):
    """A map of the Earth. ``values``: rows of values from north to south and from 180° west to 180° east, None for
    cells without data. ``unit``: unit of the values. ``coasts``: lines of (east, north) in degrees."""

    title: str
    values: list[list[Number]]
    unit: str
    coasts: list[list[tuple[float, float]]]
    note: str = ""
    kind: Literal["world"] = "world"


@dataclass(frozen=True)
class Shares(ReportPart):
    """Parts of a total, drawn side by side. ``whole``: the total; all values are in ``unit``."""

    title: str
    parts: list[tuple[str, float]]
    whole: float
    unit: str
    kind: Literal["shares"] = "shares"


@dataclass(frozen=True)
class Outline(ReportPart):
    """A scale drawing of the cross-section of an object, in millimetres, y upwards. ``bold``: lines of the aperture."""

    title: str
    lines: list[list[Place]]
    bold: list[list[Place]] = field(default_factory=list)
    kind: Literal["outline"] = "outline"


@dataclass(frozen=True)
class Interval(ReportPart):
    """A value with its bounds, none of them negative. ``high``: None without an upper bound."""

    group: str
    name: str
    value: float
    low: float
    high: Number


@dataclass(frozen=True)
class Intervals(ReportPart):
    """Values with their intervals, one line per value, on a common axis. Consecutive lines of a ``group`` are drawn
    together. ``log``: logarithmic axis; values of 0 are drawn at its left end."""

    title: str
    unit: str
    lines: list[Interval]
    log: bool = False
    kind: Literal["intervals"] = "intervals"


Drawn = Plot | Arrows | Cells | SkyMap | WorldMap | Shares | Outline | Intervals
"""Drawings that a pen renders."""
Drawing = Annotated[Drawn | Picture, Field(discriminator="kind")]


@dataclass(frozen=True)
class Table(ReportPart):
    """Columns and rows of text."""

    title: str
    columns: list[str]
    rows: list[list[str]]


@dataclass(frozen=True)
class Note(ReportPart):
    """A warning and a hint. ``severe``: do not use the values until it is resolved."""

    text: str
    hint: str = ""
    severe: bool = False
    code: str = ""


@dataclass(frozen=True)
class Section(ReportPart):
    """A heading with its content."""

    title: str
    text: str = ""
    facts: list[Fact] = field(default_factory=list)
    drawings: list[Drawing] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)


@dataclass(frozen=True)
class Report(ReportPart):
    """The complete report. ``subtitle``: subject and time."""

    title: str
    subtitle: str
    sections: list[Section]
    notes: list[Note] = field(default_factory=list)

    def as_dict(self) -> JsonObject:
        """Return the report as plain values."""
        return asdict(self)


_REPORT = TypeAdapter(Report)


def report_from(content: JsonObject) -> Report:
    """Restore a report from its plain values."""
    return _REPORT.validate_python(content)

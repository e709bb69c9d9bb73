"""Reports: measurements as facts, drawings and tables, with units beside the numbers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from gss.api.schemas.base import Out


class FactOut(Out):
    """One measured value."""

    label: str
    value: str
    unit: str
    note: str


class PlotSeriesOut(Out):
    """Data series of a plot."""

    label: str
    x: list[float]
    y: list[float | None]
    style: Literal["line", "dots", "bars"]


class LevelOut(Out):
    """Marked value on an axis."""

    value: float
    label: str
    vertical: bool


class PlotOut(Out):
    """Axes with series. ``time``: x values are Unix seconds."""

    kind: Literal["plot"]
    title: str
    x_label: str
    y_label: str
    series: list[PlotSeriesOut]
    levels: list[LevelOut]
    log_x: bool = False
    log_y: bool
    time: bool


class ArrowsOut(Out):
    """Vectors over the detector, drawn enlarged by ``scale``."""

    kind: Literal["arrows"]
    title: str
    columns: int
    rows: int
    col: list[float]
    row: list[float]
    d_col: list[float | None]
    d_row: list[float | None]
    scale: float
    note: str


class CellsOut(Out):
    """A map over the detector."""

    kind: Literal["cells"]
    title: str
    columns: int
    rows: int
    values: list[list[float | None]]
    unit: str


class WorldOut(Out):
    """Map of the Earth: rows from north to south, columns from 180° west; ``coasts``: lines of (east, north) in degrees."""

    kind: Literal["world"]
    title: str
    values: list[list[float | None]]
    unit: str
    coasts: list[list[tuple[float, float]]]
    note: str


class PictureOut(Out):
    """Greyscale picture of the detector, a PNG file in base64."""

    kind: Literal["picture"]
    title: str
    png: str
    note: str


class TableViewOut(Out):
    """Table of text cells."""

    title: str
    columns: list[str]
    rows: list[list[str]]


class NoteOut(Out):
    """Note to the reader, with what to do about it."""

    text: str
    hint: str
    severe: bool
    code: str


class SectionOut(Out):
    """Section of a report."""

    title: str
    text: str
    facts: list[FactOut]
    drawings: list[Annotated[PlotOut | ArrowsOut | CellsOut | WorldOut | PictureOut, Field(discriminator="kind")]]
    tables: list[TableViewOut]


class ReportViewOut(Out):
    """Complete report."""

    title: str
    subtitle: str
    sections: list[SectionOut]
    notes: list[NoteOut]

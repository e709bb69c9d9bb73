"""The performance sheet in its stored form, with figures in user units, and as a report with drawings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from gss.domain.angles import ARCSEC_RAD
from gss.domain.camera import Camera
from gss.operations.report.figures import number
from gss.operations.report.parts import (
    Arrows,
    Drawing,
    Fact,
    Interval,
    Intervals,
    Note,
    Plot,
    Report,
    Section,
    Series,
    Table,
)
from gss.operations.studies.sheet_pieces import maybe, numbers, over_time
from gss.pipeline.sheet.noise import TemporalNoise
from gss.pipeline.sheet.rows import CONFIDENCE, SheetFigure, SheetRow
from gss.pipeline.sheet.sheet import PerformanceSheet
from gss.pipeline.sheet.spatial import SpatialErrors

SCHEMA: Final = "gss-performance-sheet-1"
STANDARD = "Terms after ECSS-E-ST-60-20C; the full text was not available, so conformity is not claimed."
DEGREE_RAD = float(np.pi / 180)
USER_UNITS: dict[str, tuple[str, float]] = {
    "rad": ("arcsec", ARCSEC_RAD),
    "rad/K": ("arcsec/K", ARCSEC_RAD),
    "rad/d": ("arcsec/day", ARCSEC_RAD),
    "rad/s": ("deg/s", DEGREE_RAD),
    "rad/s²": ("deg/s²", DEGREE_RAD),
    "s": ("s", 1.0),
    "share": ("%", 0.01),
    "px": ("px", 1.0),
    "frames": ("frames", 1.0),
    "e/s": ("e/s", 1.0),
    "1": ("", 1.0),
}
"""User unit of each internal unit, and its size in internal units."""
Source = Literal["frames", "simulated", "telemetry", "design"]
SOURCES: dict[Source, str] = {
    "frames": "frames of the unit",
    "simulated": "simulated unit",
    "telemetry": "telemetry of the unit",
    "design": "design of a camera, no unit",
}
ABSENT_IN_DESIGN = "does not follow from a design"
LINEAR_SPAN = 30
"""Largest ratio of the values of an error budget on a linear axis."""
OF_CONDITION = ": "
"""Separates a simulated condition from the quantity in the name of a figure."""
SIGNS = {"arcsec": "″", "arcsec/K": "″/K", "arcsec/day": "″/day", "deg/s": "°/s", "deg/s²": "°/s²"}


@dataclass(frozen=True)
class SheetSource:
    """Subject of a sheet. ``chain``: empty for a design; ``seed``: seed of the intervals, and of simulated frames or
    pointings."""

    unit: str
    title: str
    chain: str
    source: Source
    subject: str
    seed: int


class BoundedValue(TypedDict):
    """One figure with its interval. ``unit``: arcsec, arcsec/K, arcsec/day, deg/s, deg/s², s, %, px, frames, e/s, or "" for
    a number. ``low``, ``high``: None without a bound."""

    name: str
    value: float | None
    low: float | None
    high: float | None
    unit: str


class RowValues(TypedDict):
    """One row of a sheet. ``conditions``: conditions of the figures; ``needs``: data that are missing for the
    measurement."""

    key: str
    title: str
    measured: bool
    method: str
    conditions: str
    frames: int
    needs: str
    figures: list[BoundedValue]


class SheetValues(TypedDict):
    """Performance sheet of a unit. ``confidence``: confidence level of the intervals; ``subject``: frames, camera, time
    and chain; ``seed``: seed of the bootstrap and of simulated frames."""

    schema_name: Literal["gss-performance-sheet-1"]
    standard: str
    unit: str
    title: str
    chain: str
    source: Source
    subject: str
    seed: int
    confidence: float
    rows: list[RowValues]


def as_sheet_record(sheet: PerformanceSheet, source: SheetSource) -> SheetValues:
    """Return the sheet in user units. A bound is None if an interval has no bound."""
    return {
        "schema_name": SCHEMA,
        "standard": STANDARD,
        "unit": source.unit,
        "title": source.title,
        "chain": source.chain,
        "source": source.source,
        "subject": source.subject,
        "seed": source.seed,
        "confidence": CONFIDENCE,
        "rows": [_row(row) for row in sheet.rows],
    }


def _row(row: SheetRow) -> RowValues:
    return {
        "key": row.key,
        "title": row.title,
        "measured": row.measured,
        "method": row.method,
        "conditions": row.conditions,
        "frames": row.frames,
        "needs": row.needs,
        "figures": [_figure(f) for f in row.figures],
    }


def _figure(figure: SheetFigure) -> BoundedValue:
    unit, size = USER_UNITS[figure.unit]
    value, low, high = maybe(np.array([figure.value, figure.low, figure.high]) / size)
    return {"name": figure.name, "value": value, "low": low, "high": high, "unit": unit}


def sheet_report(sheet: PerformanceSheet, source: SheetSource, camera: Camera) -> Report:
    """Return the sheet as a report with all figures, drawings, and the method of each row."""
    rows = [_row(row) for row in sheet.rows]
    design = source.source == "design"
    table = [line for row in rows for line in _lines(row, ABSENT_IN_DESIGN if design else "not measured")]
    facts = [
        Fact("unit", source.title),
        Fact("source", SOURCES[source.source]),
        Fact("processing", f"chain {source.chain}" if source.chain else "none"),
        Fact("detector", f"{camera.columns} x {camera.rows} px, {number(camera.pixel_rad / ARCSEC_RAD, 3)}″ per pixel"),
        Fact("intervals", f"{100 * CONFIDENCE:.0f} %", "", f"{_intervals(source)}, seed {source.seed}"),
    ]
    if source.source == "simulated":
        still = "does not bend with temperature; the interval is the resolution of this test"
        facts.append(Fact("mounting", "ideal", "", still))
    sections = [
        Section(
            "Performance",
            f"{STANDARD} Axes of the camera: x and y across the boresight, z about it. Angles are one σ unless stated.",
            facts,
            error_budget(rows),
            [
                Table("Figures", ["quantity", "figure", "value", "95 %", "pointings" if design else "frames"], table),
                *condition_tables(rows),
            ],
        )
    ]
    if sheet.spatial is not None:
        sections.append(
            Section("Spatial errors", _scatter(sheet.spatial), [], _spatial_drawings(sheet.spatial, camera))
        )
    noise = [] if sheet.noise is None else _noise_drawings(sheet.noise)
    if noise:
        sections.append(Section("Temporal noise", "", [], noise))
    if sheet.reference is not None:
        remaining_drawings = over_time(
            "Rotation from the reference, without the fitted terms",
            sheet.reference.times_s,
            sheet.reference.rest_rad / ARCSEC_RAD,
            ("x", "y", "z"),
            "arcsec",
        )
        sections.append(Section("Reference", "", [], [remaining_drawings]))
    method = [[row.title, row.method, row.conditions or row.needs] for row in sheet.rows]
    sections.append(
        Section("Methods and conditions", "", [], [], [Table("Methods", ["row", "method", "conditions"], method)])
    )
    unmeasured = [row.title for row in sheet.rows if not row.measured]
    notes = (
        [
            Note(
                f"{ABSENT_IN_DESIGN if design else 'not measured'}: {', '.join(unmeasured)}",
                "The table states the data that each row needs.",
            )
        ]
        if unmeasured
        else []
    )
    return Report(f"Performance sheet: {source.title}", source.subject, sections, notes)


def _intervals(source: SheetSource) -> str:
    return "of the pointings, or Wilson" if source.source == "design" else "bootstrap or Wilson"


def _lines(row: RowValues, absent: str) -> list[list[str]]:
    if not row["measured"]:
        return [[row["title"], absent, "–", f"needs {row['needs']}", "–"]]
    rows = []
    figures = [f for f in row["figures"] if OF_CONDITION not in f["name"]]
    for k, figure in enumerate(figures):
        head = [row["title"], str(row["frames"] or "–")] if k == 0 else ["", ""]
        rows.append([head[0], figure["name"], *sheet_texts(figure), head[1]])
    return rows


def error_budget(rows: list[RowValues]) -> list[Drawing]:
    """Return a plot of the absolute values of all figures in arcseconds, except simulated conditions; an empty list if there
    are none. The axis is logarithmic if the values differ by more than ``LINEAR_SPAN``."""
    lines = []
    for row in rows:
        for f in row["figures"]:
            if f["unit"] == "arcsec" and OF_CONDITION not in f["name"] and f["value"] is not None:
                low, high = _without_sign(f["value"] if f["low"] is None else f["low"], f["high"])
                lines.append(Interval(row["title"], f["name"], abs(f["value"]), low, high))
    positive = [line.value for line in lines if line.value > 0]
    log = bool(positive) and max(positive) > LINEAR_SPAN * min(positive)
    title = f"Error budget: absolute values with {100 * CONFIDENCE:.0f} % intervals"
    return [Intervals(title, "arcsec", lines, log)] if lines else []


def _without_sign(low: float, high: float | None) -> tuple[float, float | None]:
    """Return the interval of the absolute value."""
    if high is None:
        return max(low, 0.0), None
    return (0.0 if low < 0 < high else min(abs(low), abs(high))), max(abs(low), abs(high))


def condition_tables(rows: list[RowValues]) -> list[Table]:
    """Return a table with a line per simulated condition, if there are any."""
    lines: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows:
        for figure in row["figures"]:
            condition, divider, name = figure["name"].partition(OF_CONDITION)
            if divider:
                value, bounds = sheet_texts(figure)
                lines.setdefault((row["title"], condition), {})[name] = f"{value} ({bounds})"
    if not lines:
        return []
    names = list(dict.fromkeys(name for line in lines.values() for name in line))
    first = dict(reversed(lines))
    table = [
        [title if first[title] == condition else "", condition, *(line.get(name, "–") for name in names)]
        for (title, condition), line in lines.items()
    ]
    return [Table("Simulated conditions", ["quantity", "condition", *names], table)]


def sheet_texts(figure: BoundedValue) -> tuple[str, str]:
    """Return a figure and its interval as text. All numbers of the figure have the same decimals, so that the largest has
    three digits; short times are in ms or µs. The page uses the same rule (sheet.ts)."""
    largest = max((abs(v) for v in (figure["value"], figure["low"], figure["high"]) if v is not None), default=0.0)
    unit, factor = figure["unit"], 1.0
    if unit == "s" and 0 < largest < 0.1:
        unit, factor = ("ms", 1e3) if largest >= 1e-4 else ("µs", 1e6)
    decimals = 2 - int(np.floor(np.log10(largest * factor))) if largest > 0 else 2
    decimals = min(max(decimals, 0), 7)

    def text(value: float | None) -> str:
        return "–" if value is None else f"{value * factor + 0.0:.{decimals}f}".replace("-", "\N{MINUS SIGN}")

    bounds = "\N{NO-BREAK SPACE}–\N{NO-BREAK SPACE}".join((text(figure["low"]), text(figure["high"])))
    if figure["high"] is None:
        bounds = "–" if figure["low"] is None else f"≥ {text(figure['low'])}"
    return f"{text(figure['value'])} {SIGNS.get(unit, unit)}".strip(), bounds


def _scatter(spatial: SpatialErrors) -> str:
    return f"{spatial.sightings} stars in {spatial.frames} frames; scatter of the remaining errors {spatial.noise_px:.3f} px."


def _spatial_drawings(spatial: SpatialErrors, camera: Camera) -> list[Drawing]:
    columns, rows = np.meshgrid(spatial.map_col_px, spatial.map_row_px)
    largest = float(np.linalg.norm(spatial.map_px, axis=-1).max())
    cell = camera.columns / len(spatial.map_col_px)
    arrows = Arrows(
        "Slow error over the detector",
        camera.columns,
        camera.rows,
        numbers(columns.ravel()),
        numbers(rows.ravel()),
        maybe(spatial.map_px[..., 0].ravel()),
        maybe(spatial.map_px[..., 1].ravel()),
        0.9 * cell / largest if largest > 0 else 1.0,
        f"longest {largest:.3g} px",
    )
    at = numbers(spatial.within_px)
    within = Plot(
        "Error against the position within a pixel",
        "position, px from the centre",
        "px",
        [Series("columns", at, maybe(spatial.curve_px[:, 0])), Series("rows", at, maybe(spatial.curve_px[:, 1]))],
    )
    return [arrows, within]


def _noise_drawings(noise: TemporalNoise) -> list[Drawing]:
    drawings: list[Drawing] = []
    if len(noise.allan_s):
        at, allan = numbers(noise.allan_s), noise.allan_rad / ARCSEC_RAD
        lines = [Series(axis, at, maybe(allan[:, k])) for k, axis in enumerate("xyz")]
        drawings.append(Plot("Allan deviation", "averaging time, s", "arcsec", lines, log_y=True, log_x=True))
    if len(noise.frequency_hz):
        at, power = numbers(noise.frequency_hz), noise.psd_rad2_hz / ARCSEC_RAD**2
        lines = [Series(axis, at, maybe(power[:, k])) for k, axis in enumerate("xyz")]
        drawings.append(Plot("Power spectrum", "frequency, Hz", "arcsec²/Hz", lines, log_y=True, log_x=True))
    return drawings

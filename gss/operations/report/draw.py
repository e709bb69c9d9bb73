"""Renders the drawings of a report with any pen: plots, arrows over the detector, maps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from gss.operations.report import draw_intervals, draw_sky, draw_world
from gss.operations.report.axes import MINUS, clock, log_ticks, ticks, time_ticks, written
from gss.operations.report.parts import (
    Arrows,
    Cells,
    Drawn,
    Intervals,
    Outline,
    Plot,
    Series,
    Shares,
    SkyMap,
    WorldMap,
)
from gss.operations.report.pens import COLOURS, HAIR, INK, SOFT, Pen, Point
from gss.operations.report.shades import shade

WIDTH, PLOT_HEIGHT = 510.0, 170.0
LEFT, RIGHT, TOP, BOTTOM = 54.0, 10.0, 20.0, 30.0
DETECTOR_WIDTH = 420.0
SHARES_HEIGHT, OUTLINE_HEIGHT = 54.0, 180.0


def height_of(drawing: Drawn) -> float:
    """Return the height in points of a drawing of full width."""
    if isinstance(drawing, Plot):
        return PLOT_HEIGHT
    if isinstance(drawing, SkyMap):
        return draw_sky.HEIGHT
    if isinstance(drawing, WorldMap):
        return draw_world.HEIGHT
    if isinstance(drawing, Intervals):
        return draw_intervals.height_of(drawing)
    if isinstance(drawing, Shares):
        return SHARES_HEIGHT
    if isinstance(drawing, Outline):
        return TOP + 8 + _outline_scale(drawing) * _extent(drawing)[1]
    return TOP + 16 + DETECTOR_WIDTH * drawing.rows / drawing.columns


def draw(pen: Pen, drawing: Drawn) -> None:
    """Render a drawing with its upper left corner at (0, 0)."""
    if isinstance(drawing, Plot):
        _plot(pen, drawing)
    elif isinstance(drawing, SkyMap):
        draw_sky.draw_sky(pen, drawing)
    elif isinstance(drawing, WorldMap):
        draw_world.draw_world(pen, drawing)
    elif isinstance(drawing, Intervals):
        draw_intervals.draw_intervals(pen, drawing)
    elif isinstance(drawing, Shares):
        _shares(pen, drawing)
    elif isinstance(drawing, Outline):
        _outline(pen, drawing)
    elif isinstance(drawing, Arrows):
        _arrows(pen, drawing)
    else:
        _cells(pen, drawing)


# --- plots ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _PlotArea:
    """Maps values to coordinates."""

    x0: float
    x1: float
    y0: float
    y1: float
    log_x: bool
    log_y: bool

    def x(self, value: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * _share(value, self.x0, self.x1, self.log_x)

    def y(self, value: float) -> float:
        return PLOT_HEIGHT - BOTTOM - (PLOT_HEIGHT - TOP - BOTTOM) * _share(value, self.y0, self.y1, self.log_y)


def _share(value: float, low: float, high: float, log: bool) -> float:
    """Return the position of a value between low and high, 0 … 1."""
    return math.log(max(value, low) / low) / math.log(high / low) if log else (value - low) / (high - low)


def _plot(pen: Pen, plot: Plot) -> None:
    pen.text(LEFT, 11, plot.title, size=8.5)
    area = _plot_area(plot)
    if area is None:
        pen.text(LEFT, PLOT_HEIGHT / 2, "nothing to draw", colour=SOFT)
        return
    _axes(pen, plot, area)
    for level in plot.levels:
        _level(pen, area, level.value, level.label, level.vertical)
    for k, series in enumerate(plot.series):
        _series(pen, area, series, COLOURS[k % len(COLOURS)])
    if len(plot.series) > 1:
        right_edge = WIDTH - RIGHT
        for k, series in reversed(list(enumerate(plot.series))):
            pen.text(right_edge, 11, series.label, colour=COLOURS[k % len(COLOURS)], anchor="end")
            right_edge -= 5.0 * len(series.label) + 14


def _plot_area(plot: Plot) -> _PlotArea | None:
    xs = [x for s in plot.series for x in s.x] + [v.value for v in plot.levels if v.vertical]
    ys = [y for s in plot.series for y in s.y if y is not None] + [v.value for v in plot.levels if not v.vertical]
    xs = [x for x in xs if x > 0] if plot.log_x else xs
    ys = [y for y in ys if y > 0] if plot.log_y else ys
    if not xs or not ys:
        return None
    x0, x1 = (
        (min(xs) / 1.02, max(xs) * 1.02) if plot.log_x else _with_margin(min(xs), max(xs), 0.0 if plot.time else 0.01)
    )
    if plot.log_y:
        return _PlotArea(x0, x1, min(ys) / 1.15, max(ys) * 1.15, plot.log_x, True)
    bars = any(s.style == "bars" for s in plot.series)
    low, high = _with_margin(min(0.0, *ys) if bars else min(ys), max(ys), 0.06)
    return _PlotArea(x0, x1, 0.0 if bars and min(ys) >= 0 else low, high, plot.log_x, False)


def _with_margin(low: float, high: float, share: float) -> tuple[float, float]:
    if high - low <= 1e-12 * max(1.0, abs(high)):
        return low - 0.5, high + 0.5
    return low - share * (high - low), high + share * (high - low)


def _axes(pen: Pen, plot: Plot, area: _PlotArea) -> None:
    bottom = PLOT_HEIGHT - BOTTOM
    y_ticks = log_ticks(area.y0, area.y1) if plot.log_y else ticks(area.y0, area.y1)
    if plot.log_y and len(y_ticks) < 2:
        y_ticks = ticks(area.y0, area.y1)
    step = y_ticks[1] - y_ticks[0] if len(y_ticks) > 1 else 1.0
    for value in y_ticks:
        pen.line([(LEFT, area.y(value)), (WIDTH - RIGHT, area.y(value))], HAIR, 0.4)
        pen.text(
            LEFT - 4,
            area.y(value) + 2.6,
            written(value, min(step, value) if plot.log_y else step),
            size=7,
            anchor="end",
            colour=SOFT,
        )
    x_ticks = (
        time_ticks(area.x0, area.x1)
        if plot.time
        else log_ticks(area.x0, area.x1)
        if plot.log_x
        else ticks(area.x0, area.x1, 8)
    )
    if plot.log_x and len(x_ticks) < 2:
        x_ticks = ticks(area.x0, area.x1, 8)
    step = x_ticks[1] - x_ticks[0] if len(x_ticks) > 1 else 1.0
    for value in x_ticks:
        pen.line([(area.x(value), bottom), (area.x(value), bottom + 3)], SOFT, 0.5)
        label = (
            clock(value, area.x1 - area.x0) if plot.time else written(value, min(step, value) if plot.log_x else step)
        )
        pen.text(area.x(value), bottom + 11, label, size=7, anchor="middle", colour=SOFT)
    pen.box(LEFT, TOP, WIDTH - LEFT - RIGHT, bottom - TOP, stroke=SOFT)
    pen.text((LEFT + WIDTH - RIGHT) / 2, PLOT_HEIGHT - 4, plot.x_label, size=7.5, anchor="middle", colour=SOFT)
    pen.text(10, (TOP + bottom) / 2, plot.y_label, size=7.5, anchor="middle", colour=SOFT, up=True)


def _level(pen: Pen, area: _PlotArea, value: float, label: str, vertical: bool) -> None:
    if vertical:
        pen.line([(area.x(value), TOP), (area.x(value), PLOT_HEIGHT - BOTTOM)], INK, 0.7, 3)
        pen.text(area.x(value) + 3, TOP + 8, label, size=7)
    else:
        pen.line([(LEFT, area.y(value)), (WIDTH - RIGHT, area.y(value))], INK, 0.7, 3)
        pen.text(WIDTH - RIGHT - 3, area.y(value) - 2, label, size=7, anchor="end")


def _series(pen: Pen, area: _PlotArea, series: Series, colour: str) -> None:
    if series.style == "bars":
        base = area.y(max(0.0, area.y0)) if not area.log_y else area.y(area.y0)
        for left, right, y in zip(series.x, series.x[1:], series.y, strict=False):
            if y:
                pen.box(
                    area.x(left),
                    min(area.y(y), base),
                    area.x(right) - area.x(left) - 0.4,
                    abs(base - area.y(y)),
                    fill=colour,
                )
        return
    for run in _runs(series, area.log_y):
        points = [(area.x(x), area.y(y)) for x, y in run]
        if series.style == "dots" or len(points) == 1:
            pen.dots(points, colour, 1.2)
        else:
            pen.line(points, colour, 1.1)


def _runs(series: Series, log_y: bool = False) -> list[list[Point]]:
    """Split the points of a series at gaps."""
    runs: list[list[Point]] = [[]]
    for x, y in zip(series.x, series.y, strict=True):
        if y is None or not math.isfinite(y) or (log_y and y <= 0):
            if runs[-1] and series.style != "dots":
                runs.append([])
        else:
            runs[-1].append((x, y))
    return [run for run in runs if run]


# --- shares and sections --------------------------------------------------------------------------------------------


def _shares(pen: Pen, shares: Shares) -> None:
    pen.text(0, 11, shares.title, size=8.5)
    left, label_x = 0.0, 0.0
    for k, (name, size) in enumerate(shares.parts):
        colour, length = COLOURS[k % len(COLOURS)], WIDTH * size / max(shares.whole, 1e-9)
        pen.box(left, TOP, length, 13, fill=colour)
        label = f"{name} {size:.0f} {shares.unit}"
        pen.text(label_x, TOP + 25, label, size=7.5, colour=colour)
        left, label_x = left + length, label_x + 4.2 * len(label) + 12
    pen.box(0, TOP, WIDTH, 13, stroke=SOFT)


def _extent(outline: Outline) -> Point:
    xs, ys = zip(*[p for line in (*outline.lines, *outline.bold) for p in line], strict=True)
    return max(xs) - min(xs), max(ys) - min(ys)


def _outline_scale(outline: Outline) -> float:
    width, height = _extent(outline)
    return min((WIDTH - 20) / max(width, 1e-9), OUTLINE_HEIGHT / max(height, 1e-9))


def _outline(pen: Pen, outline: Outline) -> None:
    pen.text(0, 11, outline.title, size=8.5)
    scale = _outline_scale(outline)
    points = [p for line in (*outline.lines, *outline.bold) for p in line]
    left, top = min(x for x, _ in points), max(y for _, y in points)
    for lines, colour, width in ((outline.lines, INK, 1.0), (outline.bold, COLOURS[0], 2.5)):
        for line in lines:
            pen.line([(10 + scale * (x - left), TOP + 4 + scale * (top - y)) for x, y in line], colour, width)


# --- over the detector ----------------------------------------------------------------------------------------------


def _detector(pen: Pen, title: str, columns: int, rows: int) -> Callable[[float, float], Point]:
    """Draw title and border. Return a function from (col, row) to coordinates."""
    scale = DETECTOR_WIDTH / columns
    pen.text(LEFT, 11, title, size=8.5)
    pen.box(LEFT, TOP, DETECTOR_WIDTH, rows * scale, stroke=SOFT)
    return lambda col, row: (LEFT + (col + 0.5) * scale, TOP + (row + 0.5) * scale)


def _arrows(pen: Pen, arrows: Arrows) -> None:
    to_point = _detector(pen, arrows.title, arrows.columns, arrows.rows)
    for col, row, d_col, d_row in zip(arrows.col, arrows.row, arrows.d_col, arrows.d_row, strict=True):
        if d_col is None or d_row is None:
            continue
        start, end = to_point(col, row), to_point(col + arrows.scale * d_col, row + arrows.scale * d_row)
        pen.line([start, end], COLOURS[0], 0.8)
        pen.dots([start], COLOURS[0], 1.0)
    one_px = arrows.scale * DETECTOR_WIDTH / arrows.columns
    _scale_bar(pen, arrows.rows * DETECTOR_WIDTH / arrows.columns + TOP + 10, one_px, arrows.note)


def _scale_bar(pen: Pen, y: float, one_px: float, note: str) -> None:
    """Draw the scale: a bar with its length in pixels."""
    length = next(v for v in (5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.0) if v * one_px <= 120)
    if length:
        pen.line([(LEFT, y), (LEFT + length * one_px, y)], COLOURS[0], 1.2)
        pen.text(LEFT + length * one_px + 5, y + 3, f"{length:g} px", size=7.5)
    pen.text(LEFT + DETECTOR_WIDTH, y + 3, note, size=7.5, colour=SOFT, anchor="end")


def _cells(pen: Pen, cells: Cells) -> None:
    to_point = _detector(pen, cells.title, cells.columns, cells.rows)
    numbers = [v for line in cells.values for v in line if v is not None]
    low, high = (min(numbers), max(numbers)) if numbers else (0.0, 1.0)
    cell_columns, cell_rows = cells.columns / len(cells.values[0]), cells.rows / len(cells.values)
    for j, line in enumerate(cells.values):
        for i, value in enumerate(line):
            if value is None:
                continue
            (x0, y0), (x1, y1) = (
                to_point(i * cell_columns - 0.5, j * cell_rows - 0.5),
                to_point((i + 1) * cell_columns - 0.5, (j + 1) * cell_rows - 0.5),
            )
            pen.box(x0, y0, x1 - x0, y1 - y0, fill=shade(value, low, high))
            if (x1 - x0) > 24:
                dark = (value - low) > 0.55 * (high - low)
                pen.text(
                    (x0 + x1) / 2,
                    (y0 + y1) / 2 + 2.5,
                    f"{value:.3g}".replace("-", MINUS),
                    size=6.5,
                    anchor="middle",
                    colour="#ffffff" if dark else INK,
                )
    y = TOP + DETECTOR_WIDTH * cells.rows / cells.columns + 13
    pen.text(LEFT, y, f"{low:.3g} to {high:.3g} {cells.unit}".replace("-", MINUS), size=7.5, colour=SOFT)

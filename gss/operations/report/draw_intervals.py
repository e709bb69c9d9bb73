"""Draws values with their intervals, one line per value, on a common axis."""

from __future__ import annotations

import math

from gss.operations.report.axes import log_ticks, ticks, written
from gss.operations.report.parts import Interval, Intervals
from gss.operations.report.pens import COLOURS, HAIR, SOFT, Pen

WIDTH, LEFT, RIGHT, TOP, BOTTOM = 510.0, 190.0, 14.0, 20.0, 28.0
NAME_X = 140.0
LINE_HEIGHT = 12.0


def height_of(drawing: Intervals) -> float:
    """Return the height in points of a drawing of full width."""
    return TOP + LINE_HEIGHT * len(drawing.lines) + BOTTOM


def axis_range(drawing: Intervals) -> tuple[float, float]:
    """Return the ends of the axis. A linear axis starts at 0, a logarithmic axis below the smallest positive value. The
    axis ends at 1 if all values and bounds are 0."""
    numbers = (v for line in drawing.lines for v in (line.value, line.low, line.high) if v is not None)
    largest = 1.05 * max(numbers) or 1.0
    if not drawing.log:
        return 0.0, largest
    return min(line.value for line in drawing.lines if line.value > 0) / 3, largest


def draw_intervals(pen: Pen, drawing: Intervals) -> None:
    """Draw the lines with the upper left corner at (0, 0)."""
    low, high = axis_range(drawing)
    bottom = TOP + LINE_HEIGHT * len(drawing.lines)

    def x(value: float) -> float:
        share = math.log(max(value, low) / low) / math.log(high / low) if drawing.log else value / high
        return LEFT + (WIDTH - LEFT - RIGHT) * share

    pen.text(0, 11, drawing.title, size=8.5)
    marks = log_ticks(low, high) if drawing.log else ticks(low, high)
    step = marks[1] - marks[0] if len(marks) > 1 else 1.0
    for mark in marks:
        pen.line([(x(mark), TOP), (x(mark), bottom)], HAIR, 0.4)
        label = written(mark, min(step, mark) if drawing.log else step)
        pen.text(x(mark), bottom + 10, label, size=7, anchor="middle", colour=SOFT)
    pen.text((LEFT + WIDTH - RIGHT) / 2, bottom + 21, drawing.unit, size=7.5, anchor="middle", colour=SOFT)
    for k, line in enumerate(drawing.lines):
        upper = high if line.high is None else line.high
        _line(pen, line, TOP + LINE_HEIGHT * (k + 0.5), (x(line.low), x(line.value), x(upper)))
        if k == 0 or line.group != drawing.lines[k - 1].group:
            pen.line([(0, TOP + LINE_HEIGHT * k), (WIDTH - RIGHT, TOP + LINE_HEIGHT * k)], SOFT, 0.4)
            pen.text(0, TOP + LINE_HEIGHT * (k + 0.5) + 2.6, line.group, size=7.5)
    pen.line([(LEFT, TOP), (LEFT, bottom)], SOFT, 0.6)


def _line(pen: Pen, line: Interval, y: float, at: tuple[float, float, float]) -> None:
    """Draw one line at ``y``. ``at``: positions of the lower bound, the value and the upper bound. An end without a bound
    has no stroke across."""
    low, value, high = at
    pen.text(NAME_X, y + 2.6, line.name, size=7.5, colour=SOFT)
    pen.line([(low, y), (high, y)], COLOURS[0], 1.0)
    for end in (low, high) if line.high is not None else (low,):
        pen.line([(end, y - 2.5), (end, y + 2.5)], COLOURS[0], 1.0)
    pen.dots([(value, y)], COLOURS[0], 2.0)

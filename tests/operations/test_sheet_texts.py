"""Figures of a performance sheet as text: equal decimals within a figure, short times in small units, conditions in a table."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from gss.instruments.registry import shipped_camera
from gss.operations.report.draw_intervals import axis_range
from gss.operations.report.html import as_svg
from gss.operations.report.parts import Interval, Intervals
from gss.operations.studies.analyse import AnalysisRun, subject_of
from gss.operations.studies.night_frames import Shot
from gss.operations.studies.sheet_record import BoundedValue, RowValues, condition_tables, error_budget, sheet_texts


def figure(value: float | None, low: float | None, high: float | None, unit: str, name: str = "x") -> BoundedValue:
    """Return one figure with its interval."""
    return {"name": name, "value": value, "low": low, "high": high, "unit": unit}


@pytest.mark.parametrize(
    ("given", "value", "bounds"),
    [
        (figure(-1.23456, -2, 0, "arcsec"), "−1.23 ″", "−2.00 – 0.00"),
        (figure(97.04, 90, 99, "%"), "97.0 %", "90.0 – 99.0"),
        (figure(0.00582, -0.0115, 0.0273, "arcsec/K"), "0.0058 ″/K", "−0.0115 – 0.0273"),
        (figure(0.0033, -0.00432, 0.00949, "s"), "3.30 ms", "−4.32 – 9.49"),
        (figure(2.23e-5, -5.89e-5, 9.79e-5, "s"), "22.3 µs", "−58.9 – 97.9"),
        (figure(12345.6, 12000, 13000, "e/s"), "12346 e/s", "12000 – 13000"),
        (figure(1, 0.5, None, "deg/s"), "1.00 °/s", "≥ 0.50"),
        (figure(None, None, None, ""), "–", "–"),
        (figure(0, 0, 0, "px"), "0.00 px", "0.00 – 0.00"),
    ],
)
def test_numbers_of_a_figure_have_equal_decimals(given: BoundedValue, value: str, bounds: str) -> None:
    """The largest number has three digits, and the interval is not divided by a line break."""
    text, interval = sheet_texts(given)
    assert (text, interval.replace("\N{NO-BREAK SPACE}", " ")) == (value, bounds)
    assert " " not in interval.removeprefix("≥ ")


@pytest.mark.parametrize(
    ("after", "span"),
    [
        (timedelta(hours=1), "2026-12-01 22:00:00Z to 23:00:00Z"),
        (timedelta(hours=3), "2026-12-01 22:00:00Z to 2026-12-02 01:00:00Z"),
        (timedelta(days=365), "2026-12-01 22:00:00Z to 2027-12-01 22:00:00Z"),
    ],
)
def test_a_report_states_the_day_of_its_last_frame(after: timedelta, span: str) -> None:
    """The last time has a date if it is on another day than the first one."""
    first = datetime(2026, 12, 1, 22, tzinfo=UTC)
    shots = [Shot(f"{at}", at, 0.25, 8, lambda: np.zeros((2, 2))) for at in (first, first + after)]
    assert f", {span}, chain" in subject_of(AnalysisRun(shots, [None, None], shipped_camera("cubestar")))


def test_conditions_are_lines_of_a_table() -> None:
    """Each condition is a line with its figures as columns. A missing figure is a dash."""
    row: RowValues = {
        "key": "robustness",
        "title": "Robustness",
        "measured": True,
        "method": "",
        "conditions": "",
        "frames": 100,
        "needs": "",
        "figures": [
            figure(40, 39, 41, "e/s", "dark current"),
            figure(0, 0, 4, "%", "full Moon: correct"),
            figure(92, 85, 96, "%", "20 false stars: correct"),
            figure(16, 14, 18, "arcsec", "20 false stars: error across"),
        ],
    }
    [table] = condition_tables([row])
    assert table.columns == ["quantity", "condition", "correct", "error across"]
    assert [line[:2] for line in table.rows] == [["Robustness", "full Moon"], ["", "20 false stars"]]
    assert (table.rows[0][3], table.rows[1][3].split()[:2]) == ("–", ["16.0", "″"])
    assert condition_tables([{**row, "figures": row["figures"][:1]}]) == []


def test_an_error_budget_has_the_angles_of_all_rows_without_their_signs() -> None:
    """An interval across zero starts at zero. Rates, pixels and simulated conditions are not part of the budget. Values
    that differ much have a logarithmic axis."""
    bias: RowValues = {
        "key": "bias",
        "title": "Bias",
        "measured": True,
        "method": "",
        "conditions": "",
        "frames": 9,
        "needs": "",
        "figures": [
            figure(-3, -5, -2, "arcsec"),
            figure(-1, -4, 2, "arcsec", "y"),
            figure(2, 1, None, "arcsec", "z"),
            figure(9, 8, 9, "arcsec/day", "drift x"),
            figure(1, 0, 2, "px", "one star"),
            figure(16, 14, 18, "arcsec", "20 false stars: error across"),
        ],
    }
    [plot] = error_budget([bias])
    assert isinstance(plot, Intervals)
    assert [(line.name, line.value, line.low, line.high) for line in plot.lines] == [
        ("x", 3, 2, 5),
        ("y", 1, 0, 4),
        ("z", 2, 1, None),
    ]
    assert {line.group for line in plot.lines} == {"Bias"}
    assert not plot.log
    [wide] = error_budget([bias, {**bias, "title": "Noise", "figures": [figure(0.01, 0.005, 0.02, "arcsec")]}])
    assert isinstance(wide, Intervals)
    assert wide.log
    assert axis_range(wide)[0] < 0.01
    assert error_budget([{**bias, "figures": bias["figures"][3:]}]) == []


def test_an_upper_bound_of_zero_is_not_a_missing_bound() -> None:
    """The interval [0, 0] has both end strokes at the left end of the axis. Without an upper bound it extends to the right
    end. The axis is not empty if all values are 0."""
    zero, unbounded = (Intervals("t", "arcsec", [Interval("g", "x", 0.0, 0.0, high)]) for high in (0.0, None))
    assert axis_range(zero) == axis_range(unbounded) == (0.0, 1.0)
    end_stroke = "<polyline points='190.0,23.5 190.0,28.5'"
    across = "<polyline points='190.0,26.0 496.0,26.0'"
    assert (as_svg(zero).count(end_stroke), as_svg(zero).count(across)) == (2, 0)
    assert (as_svg(unbounded).count(end_stroke), as_svg(unbounded).count(across)) == (1, 1)

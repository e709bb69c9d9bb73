"""Figures of a performance sheet as text: equal decimals within a figure, short times in small units, conditions in a table."""

from __future__ import annotations

import pytest

from gss.operations.studies.sheet_record import BoundedValue, RowValues, condition_tables, sheet_texts


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

"""Reports with the same content as JSON, HTML and PDF."""

from __future__ import annotations

import json
import re
import zlib
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path

import pytest

from gss.operations.report import pdf
from gss.operations.report.axes import clock, decades, ticks, written
from gss.operations.report.html import as_html, as_svg
from gss.operations.report.parts import (
    Arrows,
    Cells,
    Fact,
    Interval,
    Intervals,
    Level,
    Note,
    Plot,
    Report,
    Section,
    Series,
    Table,
    report_from,
)
from gss.operations.report.pdf import as_pdf

MADE = datetime(2026, 12, 1, tzinfo=UTC)
SCATTER = Plot("Offsets", "UTC", "arcsec", [Series("x", [0.0, 60.0, 120.0], [1.0, None, -2.0], "dots")], time=True)
REPORT = Report(
    "Night of <tests>",
    "3 frames",
    [
        Section(
            "Accuracy",
            "Across the boresight.",
            [Fact("σ across", "9.2", "″", "n = 3")],
            [
                SCATTER,
                Plot("Histogram", "arcsec", "frames", [Series("x", [0.0, 1.0, 2.0], [3.0, 1.0], "bars")]),
                Plot(
                    "Noise", "s", "arcsec", [Series("NEA", [0.1, 1.0], [30.0, 3.0])], [Level(10.0, "limit")], log_y=True
                ),
                Arrows("Residuals", 100, 50, [10.0, 90.0], [10.0, 40.0], [0.5, None], [0.1, None], 20.0),
                Cells("rms", 100, 50, [[0.1, None], [0.2, 0.3]], "px"),
                Intervals("Budget", "arcsec", [Interval("Bias", "x", 3.0, 2.0, None)]),
                Intervals(
                    "Budget",
                    "arcsec",
                    [Interval("Bias", "x", 30.0, 2.0, 40.0), Interval("Noise", "x", 0.0, 0.0, 1.0)],
                    True,
                ),
            ],
            [Table("Axes", ["axis", "σ"], [["x", "9.1″"]])],
        )
    ],
    [Note("few stars", "take more frames", True, "few-stars")],
)


def test_a_report_survives_its_json() -> None:
    """The stored report equals the one read back."""
    assert report_from(json.loads(json.dumps(REPORT.as_dict()))) == REPORT


def test_the_sheet_is_well_formed_and_loads_nothing() -> None:
    """Every tag is closed, text is escaped, and there is no external address."""

    class Tags(HTMLParser):
        """Checks that tags close in order."""

        def __init__(self) -> None:
            super().__init__()
            self.open: list[str] = []

        def handle_starttag(self, tag: str, attrs: object) -> None:
            if tag != "meta":
                self.open.append(tag)

        def handle_startendtag(self, tag: str, attrs: object) -> None:
            """Do nothing: a self-closing tag needs no end tag."""

        def handle_endtag(self, tag: str) -> None:
            assert self.open.pop() == tag

    sheet = as_html(REPORT)
    tags = Tags()
    tags.feed(sheet)
    assert tags.open == []
    assert "Night of &lt;tests&gt;" in sheet
    assert not re.search(r"(src|href)=", sheet)
    assert "http://" not in sheet.replace("http://www.w3.org/2000/svg", "")


def test_characters_without_a_glyph_are_replaced_in_every_text() -> None:
    """A text that contains characters without a glyph, such as one that reverses the direction of the text, is readable in
    the sheet and in its drawings. Line breaks and wide spaces are kept."""
    text = "cat\u202egpj.exe\x00\u200b, 5\u202fpx\nnext"
    series = Plot(text, "x", "y", [Series(text, [0.0, 1.0], [0.0, 1.0])])
    table = Table(text, [text], [[text]])
    sheet = as_html(Report(text, text, [Section(text, text, [Fact(text, text, text)], [series], [table])], []))
    assert not re.search("[\u202e\x00\u200b]", sheet)
    assert sheet.count("cat\ufffdgpj.exe\ufffd\ufffd, 5\u202fpx\nnext") >= 9


def test_the_pdf_has_the_same_content_and_is_reproducible() -> None:
    """The same report gives the same bytes; the pages contain drawings and text."""
    first, repeated = as_pdf(REPORT, MADE), as_pdf(REPORT, MADE)
    assert first == repeated
    assert first.startswith(b"%PDF-")
    streams = [s for s in re.findall(rb"stream\n(.*?)\nendstream", first, re.DOTALL) if s[:1] == b"x"]
    pages = b"".join(zlib.decompress(s) for s in streams)
    assert pages.count(b" re") > 5
    assert pages.count(b" Tj") + pages.count(b"] TJ") > 20


@pytest.mark.parametrize("built", [True, False])
def test_the_pdf_states_which_characters_it_cannot_show(monkeypatch: pytest.MonkeyPatch, built: bool) -> None:
    """Characters without a glyph and control characters are replaced and listed. Line breaks are kept, and a long word is
    wrapped, so that all its letters are on the page."""
    if not built:
        monkeypatch.setattr(pdf, "FONTS", Path("absent"))
    shown: list[str] = []
    put = pdf._Sheet.put

    def record(sheet: pdf._Sheet, x: float, y: float, text: str, **style: object) -> None:
        shown.append("".join(letters for _, letters in sheet._runs(text)))
        put(sheet, x, y, text, **style)

    monkeypatch.setattr(pdf._Sheet, "put", record)
    text = "Bank B not confirmed.\n\nFrame 7 日\x1b[31m " + 900 * "w"
    as_pdf(Report("Contact 1", "", [Section("Hand-over note", text)]), MADE)
    assert shown[2:5] == ["Bank B not confirmed.", "", "Frame 7 ??[31m"]
    assert "".join(shown).count("w") - "".join(shown[:3]).count("w") >= 900
    assert "U+001B, U+65E5" in " ".join(shown)
    shown.clear()
    as_pdf(REPORT, MADE)
    assert "do not contain" not in " ".join(shown)


def test_an_empty_plot_has_a_message() -> None:
    """A plot without numbers has a text instead of axes."""
    assert "nothing to draw" in as_svg(Plot("Empty", "x", "y", [Series("a", [], [])]))
    assert "nothing to draw" in as_svg(Plot("Empty", "x", "y", [Series("a", [1.0], [None])]))


def test_missing_values_break_a_line() -> None:
    """A missing value splits the line into two."""
    line = Plot("Line", "x", "y", [Series("a", [0, 1, 2, 3, 4], [0.0, 1.0, None, 1.0, 2.0])])
    assert as_svg(line).count("stroke-width='1.1'") == 2


def test_ticks_are_round_and_inside_the_axis() -> None:
    """Axis numbers are multiples of 1, 2, 2.5 or 5 times a power of ten, with the necessary decimals."""
    assert ticks(0.0, 1.0) == [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]
    assert ticks(5.0, 5.0) == []
    assert decades(0.05, 200.0) == [0.1, 1.0, 10.0, 100.0]
    assert [written(v, 0.25) for v in (0.25, -0.5)] == ["0.25", "−0.50"]
    assert written(2e-7, 1e-7) == "2.0e−07"
    assert clock(3600.0, 60.0) == "01:00:00"
